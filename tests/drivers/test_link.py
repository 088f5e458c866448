"""What a robot gets over the link, and what is logged of it; on a robot in this process."""

import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from rigs.call_log import CallLog
from rigs.robots import DETAIL, GESTURE, STATUS, States, linked, login_in, message
from rigs.stub_robot import StubRobot
from rigs.wait import wait_for

from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.session import RobotError, RobotLost, RobotSession, RobotSettings

URL = StubRobot.url


@contextmanager
def robot_and_link(**settings: Any) -> Iterator[tuple[StubRobot, RobotLink, CallLog, States]]:
    """A robot that is switched on, a link to it that is up, the robot's calls and the link's states."""
    calls = CallLog()
    with StubRobot(calls.add) as robot, linked(robot, **settings) as (link, states):
        states.wait_for("up")
        yield robot, link, calls, states


def raised(calls: CallLog) -> list[tuple[object, ...]]:
    return [call.arguments for call in calls.all() if call.method == "raiseEvent"]


def test_each_pad_has_events_of_its_own() -> None:
    with robot_and_link(pads=("head", "wrist")) as (_, link, calls, _):
        link.put(*message("pat", 7, pad="wrist", time_s=1_790_000_000.25, confidence=0.75))
        calls.wait_for_raise("TouchGesture/wrist/Gesture", "pat")
        link.set_status("degraded", "head")
        calls.wait_for_raise("TouchGesture/head/Status", "degraded")
    assert raised(calls) == [
        ("TouchGesture/head/Status", "up"),
        ("TouchGesture/wrist/Status", "up"),
        ("TouchGesture/wrist/Detail", ["pat", 0.75, [1_790_000_000, 250_000], "early", 7, 7]),
        ("TouchGesture/wrist/Gesture", "pat"),
        ("TouchGesture/head/Status", "degraded"),
        ("TouchGesture/head/Status", "down"),
        ("TouchGesture/wrist/Status", "down"),
    ]
    removed = [call.arguments for call in calls.all() if call.method == "removeData" and not call.refused]
    assert removed == [("TouchGesture/wrist/Gesture",)]


@pytest.mark.parametrize(
    ("time_s", "sent"),
    [(1_790_000_000.9999999, [1_790_000_001, 0]), (2.0**31 - 0.5, [2**31 - 1, 500_000]), (2.0**31, [0, 0])],
)
def test_a_time_is_sent_in_seconds_and_microseconds_that_fit(time_s: float, sent: list[int]) -> None:
    with robot_and_link() as (_, link, calls, _):
        link.put(*message(time_s=time_s, sequence=2**31 - 1))
        calls.wait_for_raise(GESTURE, "stroke")
    (detail,) = calls.raised(DETAIL)
    assert isinstance(detail, list)
    assert (detail[2], detail[-1]) == (sent, 2**31 - 1)


def test_the_last_gesture_is_shown_for_a_second() -> None:
    with robot_and_link(pads=("head", "arm")) as (robot, link, calls, _):
        link.put(*message("stroke", pad="head"))
        time.sleep(0.2)
        link.put(*message("pat", pad="head"))
        link.put(*message("pat", pad="arm"))
        shown = calls.wait_for_raise("TouchGesture/arm/Gesture", "pat")
        # Another program may remove it.
        robot.services["ALMemory"].removeData("TouchGesture/arm/Gesture")  # type: ignore[attr-defined]
        refused = calls.wait_for(lambda call: bool(call.refused))
        assert refused.arguments == ("TouchGesture/arm/Gesture",)
        (removed,) = (call for call in calls.all() if call.arguments == ("TouchGesture/head/Gesture",))
        for each in (removed, refused):
            assert 0.95 < each.time_s - shown.time_s < 1.9
        # Removing it is tried once, and later answers arrive.
        link.put(*message("rub", pad="arm"))
        calls.wait_for_raise("TouchGesture/arm/Gesture", "rub")


def test_the_status_is_sent_once_for_each_change() -> None:
    with robot_and_link() as (_, link, calls, _):
        for status in ("up", "down", "down", "up"):
            link.set_status(status)
            wait_for(lambda status=status: calls.raised(STATUS)[-1] == status)  # type: ignore[misc]
            link.put(*message(status))
            calls.wait_for_raise(GESTURE, status)
    assert calls.raised(STATUS) == ["up", "down", "up", "down"]


def test_two_links_with_one_prefix_warn_and_stay_up(caplog: pytest.LogCaptureFixture) -> None:
    calls, other = CallLog(), States()
    with StubRobot(calls.add) as robot, linked(robot) as (link, states):
        states.wait_for("up")
        second = RobotLink(RobotSettings(url=URL), other, robot.open_session)
        second.set_status("down")
        second.start()
        # The first replaces the "down", which the second notices as well.
        shared = f"another touchd writes {STATUS}; give one of them robot.prefix"
        wait_for(lambda: caplog.messages.count(shared) == 2)
        second.set_status("up")
        wait_for(lambda: calls.raised(STATUS) == ["up", "down", "up", "up"])
        second.stop()
        link.set_status("degraded")
        calls.wait_for_raise(STATUS, "degraded")
    assert calls.raised(STATUS) == ["up", "down", "up", "up", "degraded", "down"]


def test_each_change_of_the_robots_state_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with robot_and_link() as (robot, link, calls, states):
        link.set_status("degraded")
        calls.wait_for_raise(STATUS, "degraded")
        for times in (1, 2):
            robot.kill()
            states.wait_for(*["up", "down"] * times)
            robot.start()
            states.wait_for(*["up", "down"] * times, "up")
        # A robot that has forgotten everything gets the status.
        assert calls.raised(STATUS) == ["up", *["degraded"] * 3]
    why = "the connection was closed by the robot"
    assert states.told == [*[("up", ""), ("down", why)] * 2, ("up", "")]
    down, up = caplog.messages
    assert down.startswith(f"robot {URL} is down ({why}); trying until it is there")
    assert up.startswith(f"robot {URL} is up (after ")


def test_an_absent_robot_is_tried_less_often_and_logged_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    tried: list[float] = []
    with StubRobot() as robot:

        def late(*_: object) -> RobotSession:
            tried.append(time.monotonic())
            if len(tried) == 3:
                raise TypeError("an internal error")
            if len(tried) < 5:
                raise RobotLost("no answer within 1.5 s")
            return robot.open_session()

        states = States()
        link = RobotLink(RobotSettings(url=URL), states, late)
        link.start()
        states.wait_for("down", "up")
        link.stop()
    # Pauses of 0.1, 0.2, 0.4 and 0.8 s, each shortened by at most half.
    assert tried[4] - tried[0] >= 0.75
    # A slow name of an earlier test may still be reported.
    logged = [record.levelname for record in caplog.records if "robot" in record.name]
    assert logged == ["WARNING", "ERROR", "INFO"]
    assert states.told[0] == ("down", "no answer within 1.5 s")


def test_a_link_may_be_stopped_twice_and_before_it_starts() -> None:
    RobotLink(RobotSettings(url=URL), open_session=StubRobot().open_session).stop()
    with robot_and_link() as (_, link, calls, _):
        link.stop()
        link.stop()
        assert calls.raised(STATUS) == ["up", "down"]
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("touchd-robot")]


def test_stopping_waits_no_longer_than_its_limit() -> None:
    is_over = threading.Event()

    def stuck(*_: object) -> RobotSession:
        is_over.wait()
        raise RobotLost("at last")

    link = RobotLink(RobotSettings(url=URL), open_session=stuck)
    link.start()
    started_s = time.monotonic()
    link.stop(0.1)
    assert time.monotonic() - started_s < 0.9
    is_over.set()
    link.stop()


@pytest.mark.parametrize(
    ("url", "host", "port"),
    [
        ("tcps://nao.local:1", "nao.local", 1),
        ("tcp://nao.local:65535", "nao.local", 65535),
        ("TCP://Nao.local:9559 ", "Nao.local", 9559),
        *(("nao.local ", "nao.local", 9559), ("nao.local:9503", "nao.local", 9503)),
        ("tcp://[fe80::1%eth0]:9559", "fe80::1%eth0", 9559),
        *(("tcp://nao", "nao", 9559), ("tcps://nao:", "nao", 9503), ("tcp://[::1]", "::1", 9559)),
    ],
)
def test_these_are_addresses(url: str, host: str, port: int) -> None:
    assert RobotSettings(url=url).address[1:] == (host, port)


NO_ADDRESS = "is not a robot's name or address"
NAO, PIN = "tcps://nao:9503", f"sha256:{'0a:' * 31}0A"
TOKEN = {"user": "nao", "token_file": "/dev/null"}


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        *(({"url": f"tcp://nao:{port}"}, NO_ADDRESS) for port in (65536, 123456, 0, "port", "9559/x")),
        *(({"url": url}, NO_ADDRESS) for url in ("udp://nao:1", "tcp://a b:9", "::1", "tcp://::1:9")),
        ({"url": "tcp://nao:s3cret@nao:9559"}, rf"tcp://\*\*\*@nao:9559' {NO_ADDRESS}"),
        *(({"url": NAO, "prefix": prefix}, "must be one word") for prefix in ("ALTouch", "a/b", "")),
        ({"url": NAO, "user": "nao", "token_file": "s3cret"}, "token_file is not a full path"),
        ({"url": NAO, "user": "nao"}, "user lacks its token; set token_file"),
        ({"url": "tcp://nao:9559", **TOKEN}, "not encrypted; use tcps://"),
        ({"url": "tcp://nao:9559", "certificate": PIN}, "not encrypted; use tcps://"),
        ({"url": NAO, "certificate": PIN, "client": "qi"}, "qi accepts any certificate"),
    ],
)
def test_settings_that_cannot_be_meant_are_refused(settings: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint) as error:
        RobotSettings(**settings)
    assert "s3cret" not in str(error.value)


@pytest.mark.parametrize(
    ("token_file", "complaint"),
    [
        ("/no/such", r"cannot be read \(No such"),
        ("/dev/zero", r"cannot be read \(Is a device"),
        *((file, "is empty or too large") for file in ("empty", "large", "pipe")),
    ],
)
def test_a_token_that_cannot_be_read_is_named(token_file: str, complaint: str, tmp_path: Path) -> None:
    (tmp_path / "empty").touch()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_text("x" * 4097)
    token_file = str(tmp_path / token_file)
    with pytest.raises(RobotError, match=rf"robot\.token_file {token_file} {complaint}"):
        RobotLink(RobotSettings(url=NAO, user="nao", token_file=token_file))


def test_a_token_is_sent_only_where_the_robot_is_known(tmp_path: Path) -> None:
    login = login_in(tmp_path)
    for known in (PIN, "any"):
        RobotLink(RobotSettings(url=NAO, **login | {"certificate": known}))
    with pytest.raises(RobotError, match=r"set robot\.certificate to .* or any"):
        RobotLink(RobotSettings(url=NAO, **login | {"certificate": None}))
