"""How long `publish()` takes in each state of the robot, and why the longest took so long; prints JSON.

    PYTHONPATH=.:tests python tests/by_hand/publish_figures.py [--busy] [--count N]

In a process set up as the daemon's is, on real qi. The kernel's counts for its thread tell why a publish was
slow: it "waited" when the thread gave up the processor, for a lock of ours or Python's own; it was "put
aside" when the kernel preempted it, which no program can help.
"""

import argparse
import json
import logging
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from rigs.robots import Robot, linked, message

from daemon.commands.run import favour_latency
from drivers.robot.actions import Action, ActionRule
from drivers.robot.link import RobotLink

# Answers come a few times a second; this rate meets the worker at every moment.
EVERY_S = 0.005
ACTIONS = (ActionRule(do=(Action(say="{gesture}"),), stages=("early",)),)
STATES = ("up", "slow", "hung", "killed", "away")


@dataclass(frozen=True)
class Publish:
    """One publish. wall_s, cpu_s: of its thread. waited, put_aside: how often."""

    wall_s: float
    cpu_s: float
    waited: int
    put_aside: int


def publishes(link: RobotLink, count: int) -> Iterator[Publish]:
    """Publish so many messages, and yield each one's figures."""
    for number in range(count):
        time.sleep(EVERY_S)
        told = message("rub" if number % 2 else "pat", touch=number)
        before = resource.getrusage(resource.RUSAGE_THREAD)
        cpu_s, began_s = time.thread_time(), time.perf_counter()
        link.publish(told)
        wall_s, took_s = time.perf_counter() - began_s, time.thread_time() - cpu_s
        after = resource.getrusage(resource.RUSAGE_THREAD)
        yield Publish(wall_s, took_s, after.ru_nvcsw - before.ru_nvcsw, after.ru_nivcsw - before.ru_nivcsw)


@contextmanager
def in_state(state: str) -> Iterator[RobotLink]:
    """A link whose robot is in a state."""
    with Robot(call_s=0.2 if state == "slow" else 0.0) as robot, ExitStack() as closing:
        if state == "away":
            robot.kill()
        link, states = closing.enter_context(linked(robot, actions=ACTIONS))
        states.wait_for("down" if state == "away" else "up")
        if state == "hung":
            robot.hang()
        elif state == "killed":
            robot.kill()
        yield link


def summary(taken: list[Publish]) -> dict[str, float]:
    """Return the figures of one state, in milliseconds."""
    ordered = sorted(publish.wall_s for publish in taken)
    slowest = max(taken, key=lambda publish: publish.wall_s)
    undisturbed = [publish.wall_s for publish in taken if not publish.put_aside]
    figures = {
        "median": ordered[len(ordered) // 2],
        "99.9 %": ordered[int(0.999 * len(ordered))],
        "slowest": slowest.wall_s,
        "of that on the processor": slowest.cpu_s,
        "slowest of those not put aside": max(undisturbed, default=0.0),
        "most on the processor": max(publish.cpu_s for publish in taken),
    }
    counts = {
        "published": len(taken),
        "waited": sum(publish.waited > 0 for publish in taken),
        "put aside": sum(publish.put_aside > 0 for publish in taken),
        "over 5 ms": sum(publish.wall_s > 0.005 for publish in taken),
        "over 5 ms and not put aside": sum(wall_s > 0.005 for wall_s in undisturbed),
    }
    return {name: round(1000 * value, 3) for name, value in figures.items()} | counts


def main() -> None:
    """Print the figures of every state."""
    parser = argparse.ArgumentParser(description="How long publish() takes, in milliseconds.")
    parser.add_argument("--busy", action="store_true", help="with a busy loop a core beside it")
    parser.add_argument("--count", type=int, default=2000, help="publishes in each state (default 2000)")
    options = parser.parse_args()
    logging.disable()
    favour_latency()
    cores = os.cpu_count() or 1
    burners = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in range(cores if options.busy else 0)
    ]
    figures: dict[str, object] = {"load": os.getloadavg()[0], "busy loops": len(burners)}
    try:
        for state in STATES:
            with in_state(state) as link:
                figures[state] = summary(list(publishes(link, options.count)))
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    sys.stdout.write(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
