"""Measures what the link promises, on real qi; prints JSON.

PYTHONPATH=.:tests python tests/by_hand/robot_figures.py [rounds]; publish() alone: publish_figures.py.
"""

import json
import logging
import sys
import threading
import time
from collections.abc import Callable

from rigs.robots import GESTURE, Robot, States, linked, message

from daemon.commands.run import favour_latency
from drivers.robot.link import RobotLink

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
            link.publish(message("rub"))

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
    link.publish(message("fresh"))
    robot.calls.wait_for_raise(GESTURE, "fresh")
    return time.monotonic() - began_s


def main(rounds: int) -> None:
    """Print the longest time of each kind, in seconds."""
    logging.disable()
    favour_latency()
    longest: dict[str, float] = {}
    for number in range(rounds):
        for kind in (idle_kill, idle_hang, busy_hang):
            with Robot() as robot, linked(robot) as (link, states):
                states.wait_for("up")
                # At another moment of the heartbeat each time.
                time.sleep(0.3 * (number + 1) / rounds)
                for name, took_s in kind(robot, link, states).items():
                    longest[name] = max(longest.get(name, 0.0), took_s)
    sys.stdout.write(
        json.dumps({name: round(took_s, 4) for name, took_s in longest.items()}, indent=1) + "\n"
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
