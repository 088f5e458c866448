"""Measures the link's guarantees on real qi, in a process set up as the daemon's is; prints JSON.

    PYTHONPATH=.:tests python tests/by_hand/robot_figures.py [--rounds 10] [--publishes 0] [--busy]

--rounds: how long a kill and a hang of the robot go unnoticed, and how soon events flow again.
--publishes: how long this many calls of publish() take in each state of the robot. The kernel's counts for
the thread tell why a call was slow: it "waited" when the thread gave up the processor, for a lock of ours or
Python's own; it was "put aside" when the kernel preempted it, which no program can prevent.
"""

import argparse
import json
import logging
import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from rigs.robots import GESTURE, Robot, States, answer, linked, message

from touchd.daemon.commands.run import favour_latency
from touchd.drivers.robot.link import RobotLink

# Far shorter than the time between answers, so that calls meet the worker in every phase.
EVERY_S = 0.005
STATES = ("up", "slow", "hung", "killed", "away")


@dataclass(frozen=True)
class Publish:
    """One call. wall_s, cpu_s: its duration. waited, put_aside: the kernel's counts, see above."""

    wall_s: float
    cpu_s: float
    waited: int
    put_aside: int


def publishes(link: RobotLink, count: int) -> Iterator[Publish]:
    """Publish `count` messages, and yield each call's figures."""
    for number in range(count):
        time.sleep(EVERY_S)
        gesture = "rub" if number % 2 else "pat"
        before = resource.getrusage(resource.RUSAGE_THREAD)
        cpu_s, began_s = time.thread_time(), time.perf_counter()
        answer(link, gesture, number)
        wall_s, took_s = time.perf_counter() - began_s, time.thread_time() - cpu_s
        after = resource.getrusage(resource.RUSAGE_THREAD)
        yield Publish(wall_s, took_s, after.ru_nvcsw - before.ru_nvcsw, after.ru_nivcsw - before.ru_nivcsw)


@contextmanager
def in_state(state: str) -> Iterator[RobotLink]:
    """Yield a link whose robot is in a state."""
    with Robot(call_s=0.2 if state == "slow" else 0.0) as robot, ExitStack() as closing:
        if state == "away":
            robot.kill()
        link, states = closing.enter_context(linked(robot, acts=True))
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


Round = Callable[[Robot, RobotLink, States], dict[str, float]]


def idle_kill(robot: Robot, link: RobotLink, states: States) -> dict[str, float]:
    """The robot dies while the link is idle, and is back after 3 s."""
    began_s = time.monotonic()
    robot.kill()
    states.wait_for("up", "down")
    noticed_s = time.monotonic() - began_s
    time.sleep(3.0)
    robot.start()
    return {"kill noticed": noticed_s, "flow again after its return": flow(robot, link)}


def idle_hang(robot: Robot, link: RobotLink, states: States) -> dict[str, float]:
    """The robot hangs while the link is idle."""
    return {"idle hang noticed": hang(robot, states), "flow again after it resumes": resume(robot, link)}


def busy_hang(robot: Robot, link: RobotLink, states: States) -> dict[str, float]:
    """The robot hangs while a message is published every 20 ms."""
    done = threading.Event()

    def publish() -> None:
        while not done.wait(0.02):
            link.put(message("rub"))

    publisher = threading.Thread(target=publish)
    publisher.start()
    time.sleep(0.2)
    noticed_s = hang(robot, states)
    time.sleep(2.0)
    again_s = resume(robot, link)
    done.set()
    publisher.join()
    return {"busy hang noticed": noticed_s, "flow again after it resumes": again_s}


def hang(robot: Robot, states: States) -> float:
    began_s = time.monotonic()
    robot.hang()
    states.wait_for("up", "down")
    return time.monotonic() - began_s


def resume(robot: Robot, link: RobotLink) -> float:
    time.sleep(3.0)
    robot.resume()
    return flow(robot, link)


def flow(robot: Robot, link: RobotLink) -> float:
    """Return how long it takes until a message published from now on reaches the robot."""
    began_s = time.monotonic()
    link.put(message("fresh"))
    robot.calls.wait_for_raise(GESTURE, "fresh")
    return time.monotonic() - began_s


def reactions(rounds: int) -> dict[str, float]:
    """Return the longest time of each kind, in seconds."""
    longest: dict[str, float] = {}
    for number in range(rounds):
        for kind in (idle_kill, idle_hang, busy_hang):
            with Robot() as robot, linked(robot) as (link, states):
                states.wait_for("up")
                # Start each round in another phase of the heartbeat.
                time.sleep(0.3 * (number + 1) / rounds)
                for name, took_s in kind(robot, link, states).items():
                    longest[name] = round(max(longest.get(name, 0.0), took_s), 4)
    return longest


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description="What the link to the robot promises, measured.")
    parser.add_argument("--rounds", type=int, default=10, help="kills and hangs of each kind (10)")
    parser.add_argument("--publishes", type=int, default=0, help="calls in each state of the robot (0)")
    parser.add_argument("--busy", action="store_true", help="with a busy loop on each core beside it")
    options = parser.parse_args()
    logging.disable()
    favour_latency()
    cores = (os.cpu_count() or 1) if options.busy else 0
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(cores)]
    figures: dict[str, object] = {"load": os.getloadavg()[0], "busy loops": len(burners)}
    try:
        figures |= reactions(options.rounds)
        for state in STATES if options.publishes else ():
            with in_state(state) as link:
                figures[state] = summary(list(publishes(link, options.publishes)))
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    sys.stdout.write(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
