"""What a robot gets over the link, and what is logged of it; on a robot in this process."""

import logging
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rigs.call_log import CallLog
from rigs.robots import LOGIN, States, login_in, message
from rigs.wait import wait_for

from touchd.drivers.fakes.stub_robot import StubRobot
from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.robot.acting import say
from touchd.drivers.robot.link import RobotLink, read_login
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


def test_only_a_link_to_a_real_robot_needs_qi(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "qi", None)
    RobotLink(RobotSettings(url=URL), open_session=StubRobot().open_session)
    with pytest.raises(RobotError, match="qi, the library that speaks to NAOqi"):
        RobotLink(RobotSettings(url=URL))


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


@pytest.mark.parametrize("port", ["1", "65535"])
def test_any_port_is_an_address(port: str) -> None:
    assert read_login(RobotSettings(url=f"tcps://nao.local:{port}")) is None


@pytest.mark.parametrize("url", ["tcp://nao:65536", "tcp://nao:123456", "udp://nao:9559", "tcp://a b:9559"])
def test_other_addresses_are_refused_with_an_example(url: str) -> None:
    with pytest.raises(RobotError, match=r"is not an address such as tcp://nao\.local:9559"):
        read_login(RobotSettings(url=url))


@pytest.mark.parametrize(("url", "port"), [("tcp://nao", 9559), ("tcps://nao:", 9503)])
def test_the_usual_port_is_proposed(url: str, port: int) -> None:
    with pytest.raises(
        RobotError, match=f"lacks its port, usually {port}: {url.partition(':')[0]}://nao:{port}$"
    ):
        read_login(RobotSettings(url=url))


def test_a_token_without_a_user_is_refused() -> None:
    with pytest.raises(RobotError, match="set user"):
        read_login(RobotSettings(url="tcps://nao:9503", token_file="/dev/null"))


def test_a_login_is_read_for_this_computer_and_for_others_only_if_trusted(tmp_path: Path) -> None:
    login = login_in(tmp_path)
    assert read_login(RobotSettings(url="tcps://127.0.0.1:9503", **login)) == LOGIN
    assert read_login(RobotSettings(url="tcps://nao:9503", trust_network=True, **login)) == LOGIN
    with pytest.raises(RobotError, match="trust_network"):
        read_login(RobotSettings(url="tcps://nao:9503", **login))
