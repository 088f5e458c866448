"""Stopping the link is quick and clean in every state of the robot."""

import os
import socket
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from rigs.programs import ran
from rigs.robots import CLIENTS, IMPATIENT, Robot, link_threads, linked, reach
from rigs.wait import AT_ONCE_S

from touchd.drivers.robot.session import RobotLimits


@pytest.mark.parametrize("client", CLIENTS)
@pytest.mark.parametrize("state", ["up", "killed", "hung", "hung-connect", "busy"])
def test_stopping_ends_soon_and_leaves_no_thread(state: str, client: str) -> None:
    with (
        Robot(say_s=60) as robot,
        linked(robot, client=client, limits=IMPATIENT, acts=True) as (link, states),
    ):
        reach(state, robot, link, states)
        started_s = time.monotonic()
        link.stop()
        assert time.monotonic() - started_s < AT_ONCE_S
        assert link_threads() == []


@pytest.mark.parametrize("client", CLIENTS)
def test_a_silent_listener_is_down_and_can_be_disconnected(client: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute, Robot() as robot:
        url = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        with linked(robot, client=client, url=url, limits=RobotLimits(connect_s=0.3)) as (_, states):
            assert "connecting: no answer" in states.wait_for("down")
            started_s = time.monotonic()
        assert time.monotonic() - started_s < AT_ONCE_S


EXIT_STATES = "up busy refused killed hung hung-connect mute tls wrong-token forgotten"


def _exits_cleanly(state: str) -> str:
    """Run a program that ends while its link is in a state; return how it failed, "" if it ended cleanly."""
    environment = {"PYTHONPATH": str(Path(__file__).parents[1])}
    done = ran([sys.executable, "-m", "rigs.robot_exit", state], env=os.environ | environment)
    return "" if (done.returncode, done.stdout, done.stderr) == (0, "", "") else f"{state}: {done}"


def test_a_program_with_a_hung_robot_ends_cleanly() -> None:
    assert _exits_cleanly("hung") == ""


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("state", EXIT_STATES.split())
def test_fifty_of_fifty_programs_end_cleanly_in_every_state(state: str) -> None:
    with ThreadPoolExecutor(2) as pool:
        assert [trouble for trouble in pool.map(_exits_cleanly, [state] * 50) if trouble] == []
