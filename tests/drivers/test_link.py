"""What a robot gets over the link, and what is logged of it; on a robot in this process."""

import logging
import re
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from rigs.call_log import CallLog
from rigs.robots import States, login_in, message
from rigs.stub_robot import StubRobot
from rigs.wait import wait_for

from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.robot.acting import say
from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.session import RobotError, RobotLost, RobotSession, RobotSettings

GESTURE, STATUS = "TouchGesture/Gesture", "TouchGesture/Status"
URL = StubRobot.url


@contextmanager
def robot_and_link(
    pads: Iterable[str] = (DEFAULT_PAD,), acts: bool = False
) -> Iterator[tuple[StubRobot, RobotLink, CallLog, States]]:
    """A robot that is switched on, a link to it that is up, the robot's calls and the link's states."""
    calls, states = CallLog(), States()
    with StubRobot(calls.add) as robot:
        link = RobotLink(RobotSettings(url=URL), states, robot.open_session, pads=pads, acts=acts)
        link.start()
        try:
            states.wait_for("up")
            yield robot, link, calls, states
        finally:
            link.stop()


def raised(calls: CallLog) -> list[tuple[object, ...]]:
    return [call.arguments for call in calls.all() if call.method == "raiseEvent"]


def test_each_pad_has_events_of_its_own() -> None:
    with robot_and_link(pads=("head", "wrist")) as (_, link, calls, _):
        link.put(message("pat", 7, pad="wrist", time_s=1_790_000_000.25, confidence=0.75))
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
    removed = [call.arguments for call in calls.all() if call.method == "removeData"]
    assert removed == [("TouchGesture/wrist/Gesture",)]


@pytest.mark.parametrize(
    ("time_s", "sent"),
    [(1_790_000_000.9999999, [1_790_000_001, 0]), (2.0**31 - 0.5, [2**31 - 1, 500_000]), (2.0**31, [0, 0])],
)
def test_a_time_is_sent_in_seconds_and_microseconds_that_fit(time_s: float, sent: list[int]) -> None:
    with robot_and_link() as (_, link, calls, _):
        link.put(message(time_s=time_s, sequence=2**31 - 1))
        calls.wait_for_raise(GESTURE, "stroke")
    (detail,) = calls.raised("TouchGesture/Detail")
    assert isinstance(detail, list)
    assert (detail[2], detail[-1]) == (sent, 2**31 - 1)


@pytest.mark.parametrize("is_removed_by_another", [False, True])
def test_a_gesture_is_shown_for_a_second(is_removed_by_another: bool) -> None:
    with robot_and_link(pads=("head",)) as (robot, link, calls, _):
        link.put(message("pat", pad="head"))
        shown = calls.wait_for_raise("TouchGesture/head/Gesture", "pat")
        if is_removed_by_another:
            robot.services["ALMemory"].removeData("TouchGesture/head/Gesture")  # type: ignore[attr-defined]
            calls.clear()
        removed = calls.wait_for(lambda call: call.method == "removeData", timeout_s=10)
        assert bool(removed.refused) == is_removed_by_another
        assert 0.95 < removed.time_s - shown.time_s < 1.9
        # Removing it is tried once, and later answers arrive.
        link.put(message("rub", pad="head"))
        calls.wait_for_raise("TouchGesture/head/Gesture", "rub", timeout_s=10)
    assert [call.method for call in calls.all()].count("removeData") == 2


def test_the_status_is_sent_once_for_each_change() -> None:
    with robot_and_link() as (_, link, calls, _):
        for status in ("up", "down", "down", "up"):
            link.set_status(status)
            wait_for(lambda status=status: calls.raised(STATUS)[-1] == status)  # type: ignore[misc]
            link.put(message(status))
            calls.wait_for_raise(GESTURE, status)
    assert calls.raised(STATUS) == ["up", "down", "up", "down"]


def test_a_robot_that_comes_and_goes_is_logged_and_reported(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with robot_and_link() as (robot, _, calls, states):
        robot.kill()
        states.wait_for("up", "down")
        robot.start()
        states.wait_for("up", "down", "up")
        assert calls.raised(STATUS) == ["up", "up"]
    why = "the connection was closed by the robot"
    assert states.told == [("up", ""), ("down", why), ("up", "")]
    first, second, third = (record.getMessage() for record in caplog.records)
    assert first == f"robot {URL} is up"
    assert second == f"robot {URL} is down ({why}); trying until it is there"
    assert third.startswith(f"robot {URL} is up again (after ")


def test_causes_that_differ_in_their_numbers_are_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    tried: list[str] = []

    def late(*_: object) -> RobotSession:
        tried.append("")
        raise RobotLost(f"no answer within {len(tried)}.5 s")

    states = States()
    link = RobotLink(RobotSettings(url=URL), states, late)
    link.start()
    wait_for(lambda: len(tried) >= 3)
    link.stop()
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert states.told == [("down", "no answer within 1.5 s")]


def test_a_failing_listener_leaves_the_link_at_work(caplog: pytest.LogCaptureFixture) -> None:
    def fails(*_: object) -> None:
        raise ValueError("a bug")

    calls = CallLog()
    with StubRobot(calls.add) as robot:
        link = RobotLink(RobotSettings(url=URL), fails, robot.open_session)
        link.start()
        link.put(message())
        calls.wait_for_raise(GESTURE, "stroke")
        link.stop()
    assert [one.getMessage() for one in caplog.records] == ["the state of the robot could not be reported"]


def test_a_link_may_be_stopped_twice_and_before_it_starts() -> None:
    unstarted = RobotLink(RobotSettings(url=URL), open_session=StubRobot().open_session)
    unstarted.stop()
    with robot_and_link() as (_, link, calls, _):
        link.stop()
        link.stop()
        assert calls.raised(STATUS) == ["up", "down"]
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("touchd-robot")]


def test_a_link_that_does_not_end_is_logged_and_left(caplog: pytest.LogCaptureFixture) -> None:
    begun, goes_on = threading.Event(), threading.Event()

    def hangs(*_: object) -> RobotSession:
        begun.set()
        goes_on.wait(10)
        raise RobotLost("over")

    link = RobotLink(RobotSettings(url=URL), open_session=hangs)
    link.start()
    assert begun.wait(10)
    begun_s = time.monotonic()
    link.stop(timeout_s=0.05)
    assert time.monotonic() - begun_s < 0.9
    goes_on.set()
    assert "the link to the robot did not end within 0.05 s" in caplog.messages
    link.stop()


def test_acts_need_a_link_that_was_made_for_them() -> None:
    with robot_and_link(acts=True) as (_, link, calls, _):
        link.act([say("a"), say("b")])
        wait_for(lambda: calls.said() == ["a", "b"])
    with pytest.raises(AssertionError, match="without acts"):
        RobotLink(RobotSettings(url=URL), open_session=StubRobot().open_session).act([say("a")])


@pytest.mark.parametrize(
    ("url", "host", "port"),
    [
        ("tcps://nao.local:1", "nao.local", 1),
        ("tcp://nao.local:65535", "nao.local", 65535),
        ("TCP://Nao.local:9559 ", "Nao.local", 9559),
        ("tcp://[::1]:9559", "::1", 9559),
        ("tcp://[fe80::1%eth0]:9559", "fe80::1%eth0", 9559),
    ],
)
def test_these_are_addresses(url: str, host: str, port: int) -> None:
    assert RobotSettings(url=url).address[1:] == (host, port)


@pytest.mark.parametrize(
    "url",
    [
        *("tcp://nao:65536", "tcp://nao:123456", "tcp://nao:0", "udp://nao:9559", "tcp://a b:9559"),
        *("nao.local:9559", "tcp://nao.local:port", "tcp://::1:9559", "tcp://nao:9559/x"),
    ],
)
def test_other_addresses_are_refused_with_an_example(url: str) -> None:
    with pytest.raises(ValueError, match=r"is not an address such as tcp://nao\.local:9559"):
        RobotSettings(url=url)


@pytest.mark.parametrize(
    ("url", "proposed"),
    [
        ("tcp://nao", "tcp://nao:9559"),
        ("tcps://nao:", "tcps://nao:9503"),
        ("tcp://[::1]", "tcp://[::1]:9559"),
    ],
)
def test_the_usual_port_is_proposed(url: str, proposed: str) -> None:
    with pytest.raises(ValueError, match=f"lacks its port, usually \\d+: {re.escape(proposed)}$"):
        RobotSettings(url=url)


def test_a_password_in_an_address_is_not_shown() -> None:
    with pytest.raises(ValueError, match=r"tcp://\*\*\*@nao") as error:
        RobotSettings(url="tcp://nao:s3cret@nao:9559")
    assert "s3cret" not in str(error.value)


TOKEN = {"user": "nao", "token_file": "/dev/null"}
PIN = f"sha256:{'0a:' * 31}0A"


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"url": "tcps://nao:9503", "user": "nao"}, "set token_file"),
        ({"url": "tcps://nao:9503", "token_file": "/dev/null"}, "no user"),
        ({"url": "tcp://nao:9559", **TOKEN}, "not encrypted; use tcps://"),
        ({"url": "tcp://nao:9559", "certificate": PIN}, "not encrypted; use tcps://"),
        ({"url": "tcps://nao:9503", "certificate": PIN, "client": "qi"}, "qi accepts any certificate"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(settings: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        RobotSettings(**settings)


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"token_file": "/no/such"}, r"robot\.token_file /no/such cannot be read \(No such"),
        ({"token_file": "/dev/zero"}, "larger than 4096 bytes"),
        ({"token_file": "/dev/null"}, "/dev/null is empty"),
        ({"certificate": "/no/such"}, r"robot\.certificate /no/such: .*\(No such"),
        ({"certificate": "/dev/null"}, r"robot\.certificate /dev/null: neither sha256: "),
        ({"certificate": "sha256:abc"}, r"robot\.certificate sha256:abc: neither sha256: "),
    ],
)
def test_what_cannot_be_read_is_reported_in_one_line(settings: dict[str, Any], complaint: str) -> None:
    with pytest.raises(RobotError, match=complaint):
        RobotLink(RobotSettings(url="tcps://127.0.0.1:9503", **TOKEN | settings))


def test_a_token_is_sent_only_where_the_robot_is_known(tmp_path: Path) -> None:
    login = login_in(tmp_path)
    for known in ({"certificate": PIN}, {"trust_network": True}):
        RobotLink(RobotSettings(url="tcps://nao:9503", **login, **known))
    RobotLink(RobotSettings(url="tcps://127.0.0.1:9503", **login))
    with pytest.raises(RobotError, match=r"robot\.certificate .* or robot\.trust_network"):
        RobotLink(RobotSettings(url="tcps://nao:9503", **login))


def test_two_daemons_with_one_prefix_are_told_apart(caplog: pytest.LogCaptureFixture) -> None:
    with robot_and_link() as (robot, _, calls, _):
        wait_for(lambda: calls.raised(STATUS) == ["up"])
        second = RobotLink(RobotSettings(url=URL), open_session=robot.open_session)
        second.set_status("down")
        second.start()
        # The first pad is up, whatever the other daemon writes.
        wait_for(lambda: calls.raised(STATUS) == ["up", "down", "up"])
        second.set_status("up")
        wait_for(lambda: calls.raised(STATUS) == ["up", "down", "up", "up"])
        second.stop()
        wait_for(lambda: calls.raised(STATUS)[-1] == "up")
        assert calls.raised(STATUS).count("down") in (1, 2)
    said = [line for line in caplog.messages if "another touchd" in line]
    assert said[0] == f"another touchd writes {STATUS}; give one of them robot.prefix"
    # Each link says it once at most, and its end says nothing of the other's pad.
    assert len(said) <= 2
    assert calls.raised(STATUS)[-1] == "up"
