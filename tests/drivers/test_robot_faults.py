"""Faults of the robot, logins and endings: the link recovers and stops, with our session and with qi's."""

import logging
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO

import pytest
from rigs.login_gate import Login
from rigs.programs import Program
from rigs.robots import (
    CLIENTS,
    GESTURE,
    IMPATIENT,
    LOGIN,
    STATUS,
    Robot,
    answer,
    hears,
    link_threads,
    linked,
    login_in,
    message,
    needs_qi,
    reach,
    say,
)
from rigs.wait import AT_ONCE_S, wait_for

from touchd.daemon.app.config import Settings
from touchd.daemon.doctor.machine import certificate_at, check_robot
from touchd.drivers.robot.session import RobotLimits, RobotSettings


@pytest.fixture(params=CLIENTS)
def client(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_a_kill_during_a_call_is_survived(client: str) -> None:
    limits = RobotLimits(call_s=20)
    with Robot(call_s=0.2) as robot, linked(robot, client=client, limits=limits) as (link, states):
        states.wait_for("up")
        link.put(*message("stroke"))
        robot.calls.wait_for(lambda call: "Detail" in str(call.arguments[0]))
        robot.kill()
        states.wait_for("up", "down", timeout_s=10)
        robot.start()
        states.wait_for("up", "down", "up")
        hears(robot, link)
        # A call in progress may have been carried out, so it is not repeated.
        assert robot.calls.raised(GESTURE) == ["pat"]


def test_a_hang_is_noticed_and_events_flow_again_after_it(client: str) -> None:
    with Robot() as robot, linked(robot, client=client) as (link, states):
        states.wait_for("up")
        robot.hang()
        assert "no answer within" in states.wait_for("up", "down")
        robot.resume()
        states.wait_for("up", "down", "up")
        hears(robot, link)


def test_a_robot_that_returns_gets_the_status(client: str) -> None:
    with Robot() as robot, linked(robot, client=client, limits=RobotLimits(heartbeat_s=60)) as (link, states):
        states.wait_for("up")
        link.set_status("down")
        robot.calls.wait_for_raise(STATUS, "down")
        robot.kill()
        states.wait_for("up", "down", timeout_s=10)
        robot.start()
        states.wait_for("up", "down", "up")
        robot.calls.wait_for(lambda _: robot.calls.raised(STATUS) == ["up", "down", "down"])


def test_stale_messages_are_dropped_and_fresh_ones_sent(client: str) -> None:
    limits = RobotLimits(stale_s=0.5)
    with Robot() as robot:
        robot.kill()
        with linked(robot, client=client, limits=limits) as (link, states):
            link.put(*message("stale"))
            assert "refused" in states.wait_for("down")
            time.sleep(0.6)
            robot.start()
            states.wait_for("down", "up")
            hears(robot, link, "fresh")
            assert robot.calls.raised(GESTURE) == ["fresh"]


def test_a_robot_without_its_memory_is_down_and_says_why(client: str) -> None:
    with Robot(without=["ALMemory"]) as robot, linked(robot, client=client) as (_, states):
        assert "looking for ALMemory" in states.wait_for("down")


SPEAKER = """
import sys, time
from touchd.drivers.fakes.services import fake_services
from touchd.drivers.robot.qi_session import load_qi
session = load_qi().Session()
session.connect(sys.argv[1])
session.listen("tcp://127.0.0.1:0")
told = lambda call: print(call.arguments[0], flush=True)
session.registerService("ALTextToSpeech", fake_services(told)["ALTextToSpeech"])
print("ready", flush=True)
time.sleep(60)
"""


@contextmanager
def speaker(robot: Robot) -> Iterator[IO[str]]:
    """A process of the robot's that holds its speech; yields the lines that it writes."""
    with Program(sys.executable, "-c", SPEAKER, robot.url) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            yield process.stdout
        finally:
            process.kill()


@needs_qi
def test_a_service_that_comes_back_is_used_again(caplog: pytest.LogCaptureFixture, client: str) -> None:
    with (
        Robot(without=["ALTextToSpeech"]) as robot,
        linked(robot, client=client, acts=True) as (link, states),
    ):
        states.wait_for("up")
        with speaker(robot) as said:
            link.act([say("pat")])
            assert said.readline() == "pat\n"
        link.act([say("rub")])
        wait_for(lambda: "the robot refused" in caplog.text)
        with speaker(robot) as said:
            link.act([say("stroke")])
            assert said.readline() == "stroke\n"
        states.wait_for("up")


def test_an_action_that_takes_too_long_is_cut_and_reported(
    caplog: pytest.LogCaptureFixture, client: str
) -> None:
    limits = RobotLimits(action_s=0.3)
    with Robot(say_s=1.5) as robot, linked(robot, client=client, limits=limits, acts=True) as (link, states):
        states.wait_for("up")
        link.act([say("pat"), say("rub")])
        wait_for(lambda: "given up" in caplog.text)
        states.wait_for("up")
    assert (
        "an action is given up, with those after it: ALTextToSpeech.say: no answer within 0.3" in caplog.text
    )


def test_the_heartbeat_works_without_its_service(client: str) -> None:
    limits = RobotLimits(heartbeat_s=0.02)
    with Robot(without=["ALSystem"]) as robot, linked(robot, client=client, limits=limits) as (link, states):
        states.wait_for("up")
        time.sleep(0.1)
        hears(robot, link, "stroke")
        states.wait_for("up")


@pytest.mark.parametrize("is_right", [True, False])
def test_a_login_connects_if_it_is_right_and_never_shows_the_token(
    is_right: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture, client: str
) -> None:
    caplog.set_level(logging.DEBUG)
    login = login_in(tmp_path, LOGIN if is_right else Login("nao", "wr0ng-token"))
    with Robot(login=LOGIN) as robot, linked(robot, client=client, **login, acts=True) as (link, states):
        if is_right:
            states.wait_for("up")
            answer(link, "tickle")
            robot.calls.wait_for(lambda call: call.method == "say")
        else:
            assert "check user and token" in states.wait_for("down")
        shown = repr([vars(link), states.told, caplog.text])
        assert LOGIN.token not in shown
        assert "wr0ng-token" not in shown


@pytest.mark.parametrize("encrypted", [True, False])
def test_tcp_and_tcps_mixed_up_gives_advice(encrypted: bool, client: str) -> None:
    with Robot(login=LOGIN if encrypted else None) as robot:
        url = robot.url.replace("tcps://", "tcp://") if encrypted else robot.url.replace("tcp://", "tcps://")
        with linked(robot, client=client, url=url) as (_, states):
            assert "tcp:// or tcps://" in states.wait_for("down")


def test_publishing_to_a_hung_robot_returns_at_once(client: str) -> None:
    limits = replace(IMPATIENT, capacity=5, stale_s=60)
    with Robot() as robot, linked(robot, client=client, limits=limits, acts=True) as (link, states):
        states.wait_for("up")
        robot.hang()
        states.wait_for("up", "down")
        started_s = time.monotonic()
        for number in range(500):
            answer(link, f"gesture {number}", number)
        # A generous limit: a single call to the robot may take as long as this.
        assert time.monotonic() - started_s < AT_ONCE_S
        robot.resume()
        robot.calls.wait_for_raise(GESTURE, "gesture 499")
        assert robot.calls.raised(GESTURE) == [f"gesture {number}" for number in range(495, 500)]


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


def test_a_silent_listener_is_down_and_can_be_disconnected(client: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute, Robot() as robot:
        url = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        with linked(robot, client=client, url=url, limits=RobotLimits(connect_s=0.3)) as (_, states):
            assert "connecting: no answer" in states.wait_for("down")
            started_s = time.monotonic()
        assert time.monotonic() - started_s < AT_ONCE_S


def test_only_a_robot_with_the_pinned_certificate_gets_the_token(tmp_path: Path) -> None:
    with Robot(login=LOGIN) as robot:
        shown = certificate_at(robot.url)
        assert shown is not None
        digits = shown.removeprefix("sha256:")
        pairs = ":".join(digits[at : at + 2] for at in range(0, 64, 2))
        login = login_in(tmp_path)
        with linked(robot, **login | {"certificate": f"sha256:{'ab' * 32}"}) as (_, states):
            reason = states.wait_for("down")
        assert f"not the robot of robot.certificate: this one's is {shown}" in reason
        assert robot.gate is not None
        assert robot.gate.first_messages == []
        for form in (shown, f"SHA256:{pairs.upper()}"):
            with linked(robot, **login | {"certificate": form}) as (link, states):
                states.wait_for("up")
                hears(robot, link, form)


def test_a_renewed_token_is_read_at_the_next_connection(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with Robot(login=LOGIN) as robot, linked(robot, **login_in(tmp_path)) as (link, states):
        states.wait_for("up")
        (tmp_path / "token").unlink()
        robot._login = renewed = Login(LOGIN.user, "an0ther")
        robot.kill()
        robot.start()
        wait_for(lambda: "robot.token_file" in caplog.text)
        login_in(tmp_path, renewed)
        states.wait_for("up", "down", "up")
        hears(robot, link)


def test_the_doctor_shows_the_certificate_to_pin(tmp_path: Path) -> None:
    with Robot(login=LOGIN) as robot:
        shown = certificate_at(robot.url)
        pin = f"if it is your robot, set robot.certificate: {shown}"
        without = check_robot(Settings(robot=RobotSettings(url=robot.url)))
        assert (without.verdict, without.advice.endswith(pin)) == ("to do", True)
        trusted = check_robot(Settings(robot=RobotSettings(url=robot.url, **login_in(tmp_path))))
        assert (trusted.verdict, trusted.advice) == ("ok", pin)
        pinned = RobotSettings(url=robot.url, **login_in(tmp_path) | {"certificate": shown})
        assert check_robot(Settings(robot=pinned)).advice == ""
