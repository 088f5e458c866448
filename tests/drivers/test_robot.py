"""Events and actions on the robot, faults, logins and endings: our session and qi's."""

import hashlib
import logging
import ssl
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rigs.login_gate import Login
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
    say,
)
from rigs.wait import AT_ONCE_S, wait_for

from touchd.daemon.app.config import Settings
from touchd.daemon.doctor.machine import certificate_at, check_robot
from touchd.drivers.robot.link import LIMITS, Act, RobotLink, client_of
from touchd.drivers.robot.session import RobotError, RobotLimits, RobotRefused, RobotSession, RobotSettings


# Starting a process takes longer than most of the tests that talk to it.
@pytest.fixture(
    scope="module", params=[pytest.param(False, id="qi's", marks=needs_qi), pytest.param(True, id="ours")]
)
def running_robot(request: pytest.FixtureRequest) -> Iterator[Robot]:
    with Robot(say_s=0.05, is_ours=request.param) as robot:
        yield robot


@pytest.fixture(params=CLIENTS)
def client(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def robot(running_robot: Robot) -> Iterator[Robot]:
    """A robot without earlier calls; after the test its link has ended."""
    calls = running_robot.calls
    yield running_robot
    if calls.raised(STATUS):
        calls.wait_for(lambda _: calls.raised(STATUS)[-1] == "down")
    calls.clear()


@pytest.fixture
def session(robot: Robot, client: str) -> Iterator[RobotSession]:
    settings = RobotSettings(url=robot.url, client=client)  # type: ignore[arg-type]
    with closing(client_of(settings)(settings, LIMITS, threading.Event())) as session:
        session.connect()
        yield session


def test_an_answer_is_raised_under_the_prefix_and_later_removed(robot: Robot, client: str) -> None:
    with linked(robot, client=client, prefix="Pad") as (link, _):
        link.put(*message("stroke", confidence=0.75, time_s=1_790_000_000.25, touch=7, sequence=12))
        robot.calls.wait_for_raise("Pad/Gesture", "stroke")
        detail = ["stroke", 0.75, [1_790_000_000, 250_000], "early", 7, 12]
        assert robot.calls.raised("Pad/Detail") == [detail]
    robot.calls.wait_for(lambda call: (call.method, call.arguments) == ("removeData", ("Pad/Gesture",)))


def test_the_robots_memory_holds_four_bytes(robot: Robot, session: RobotSession) -> None:
    session.call("ALMemory", "raiseEvent", "Pad/Float", 0.1, limit_s=5)
    for event, value in (("Pad/Int", 2**31), ("Pad/List", [1, [-(2**31) - 1]]), ("Pad/Float", 1e39)):
        with pytest.raises(RobotRefused, match=r"4 bytes|takes these arguments"):
            session.call("ALMemory", "raiseEvent", event, value, limit_s=5)
    robot.calls.wait_for_raise("Pad/Float", float(np.float32(0.1)))
    assert len(robot.calls.raised("Pad/Float")) == 1


@pytest.mark.parametrize(
    "value", [[], [[1.5, "Strähne", True], -(2**31)], "", "\N{WAVING HAND SIGN}", 0, False]
)
def test_a_value_comes_back_as_it_was_sent(session: RobotSession, value: object) -> None:
    session.call("ALMemory", "raiseEvent", "Pad/Any", value, limit_s=5)
    found = session.call("ALMemory", "getData", "Pad/Any", limit_s=5)
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    ("service", "method", "arguments", "complaint"),
    [
        ("ALNothing", "say", ("pat",), "looking for ALNothing: "),
        ("ALMemory", "sing", (), "ALMemory"),
        ("ALMemory", "raiseEvent", ("one",), "ALMemory"),
        ("ALMemory", "getData", ("Pad/Nothing",), "no data named Pad/Nothing"),
    ],
)
def test_a_refused_call_does_not_end_the_session(
    session: RobotSession, service: str, method: str, arguments: tuple[object, ...], complaint: str
) -> None:
    with pytest.raises(RobotRefused, match=complaint):
        session.call(service, method, *arguments, limit_s=5)
    assert session.call("ALSystem", "systemVersion", limit_s=5) == "2.8.7.4"


ACTS = [
    Act("ALLeds", "fadeRGB", ("FaceLeds", 0xFF8000, 0.5)),
    Act("ALAnimatedSpeech", "say", ("A tickle!",)),
    Act("ALBehaviorManager", "runBehavior", ("animations/Stand/Gestures/Hey_1",)),
    say("Done"),
]


def test_acts_are_carried_out_in_order(robot: Robot, client: str) -> None:
    with linked(robot, client=client, acts=True) as (link, _):
        link.act(ACTS)
        robot.calls.wait_for(lambda call: call.service == "ALTextToSpeech")
        done = [call for call in robot.calls.all() if call.service != "ALMemory"]
        expected = [(act.service, act.method, act.arguments) for act in ACTS]
        assert [(call.service, call.method, call.arguments) for call in done] == expected


def test_speech_that_takes_long_delays_no_event(client: str) -> None:
    with Robot(say_s=60) as robot, linked(robot, client=client, acts=True) as (link, _):
        answer(link, "stroke", 1)
        robot.calls.wait_for(lambda call: call.method == "say")
        link.put(*message("pat", 2))
        robot.calls.wait_for_raise(GESTURE, "pat")
        assert len(robot.calls.said()) == 1


def test_unsupported_actions_are_skipped(caplog: pytest.LogCaptureFixture, client: str) -> None:
    nosuch = [Act("ALBehaviorManager", "runBehavior", ("nosuch",)), Act("ALAnimatedSpeech", "say", ("no",))]
    without = ["ALAnimatedSpeech"]
    with Robot(without=without) as robot, linked(robot, client=client, acts=True) as (link, states):
        for gesture in ("stroke", "pat"):
            link.act([*nosuch, say(gesture)])
        robot.calls.wait_for(lambda call: call.arguments == ("pat",))
        states.wait_for("up")
    (warning,) = (record.getMessage() for record in caplog.records if record.levelname == "WARNING")
    assert "nosuch" in warning
    assert "ALAnimatedSpeech" in warning
    assert robot.calls.said() == ["stroke", "pat"]


@pytest.mark.parametrize("content", ["print 'hello'", "raise ImportError('libqi.so: no such file')"])
def test_a_failure_to_load_qi_is_reported_in_one_line(
    content: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "qi.py").write_text(content)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "qi", raising=False)
    complaint = r"^robot\.client: qi cannot be loaded \(.*leave client out, or.*$"
    with pytest.raises(RobotError, match=complaint):
        RobotLink(RobotSettings(url="tcp://nao.local:9559", client="qi"))


@pytest.fixture(params=["touchd", pytest.param("qi", marks=[needs_qi, pytest.mark.slow])])
def either(request: pytest.FixtureRequest) -> str:
    """The client in tests that take a second, or more: qi's is tested in the slow suite."""
    return str(request.param)


def test_a_kill_during_a_call_is_survived(either: str) -> None:
    limits = RobotLimits(call_s=20)
    with Robot(call_s=0.2) as robot, linked(robot, client=either, limits=limits) as (link, states):
        states.wait_for("up")
        link.put(*message("stroke"))
        robot.calls.wait_for(lambda call: "Detail" in str(call.arguments[0]))
        robot.stop()
        states.wait_for("up", "down")
        robot.start()
        states.wait_for("up", "down", "up")
        hears(robot, link)
        # A call in progress may have been carried out, so it is not repeated.
        assert robot.calls.raised(GESTURE) == ["pat"]


def test_a_hang_is_noticed_and_events_flow_again_after_it(either: str) -> None:
    with Robot() as robot, linked(robot, client=either, limits=IMPATIENT) as (link, states):
        states.wait_for("up")
        robot.hang()
        assert "no answer within" in states.wait_for("up", "down")
        robot.resume()
        states.wait_for("up", "down", "up")
        hears(robot, link)


def test_stale_messages_are_dropped_and_fresh_ones_sent(either: str) -> None:
    limits = RobotLimits(stale_s=0.5)
    with Robot() as robot:
        robot.stop()
        with linked(robot, client=either, limits=limits) as (link, states):
            link.put(*message("stale"))
            assert "refused" in states.wait_for("down")
            time.sleep(0.6)
            robot.start()
            states.wait_for("down", "up")
            hears(robot, link, "fresh")
            assert robot.calls.raised(GESTURE) == ["fresh"]


def test_a_robot_without_its_memory_is_down_and_says_why(either: str) -> None:
    with Robot(without=["ALMemory"]) as robot, linked(robot, client=either) as (_, states):
        assert "looking for ALMemory" in states.wait_for("down")


def test_an_overlong_action_is_cut_with_those_after_it(either: str) -> None:
    limits = RobotLimits(action_s=0.3)
    with Robot(say_s=1.5) as robot, linked(robot, client=either, limits=limits, acts=True) as (link, states):
        states.wait_for("up")
        link.act([say("pat"), say("rub")])
        link.act([say("tickle")])
        robot.calls.wait_for(lambda call: call.arguments == ("tickle",))
        states.wait_for("up")
    assert robot.calls.said() == ["pat", "tickle"]


@pytest.mark.parametrize("is_right", [True, False])
def test_only_the_right_login_connects_and_no_token_is_shown(
    is_right: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture, either: str
) -> None:
    caplog.set_level(logging.DEBUG)
    login = login_in(tmp_path, LOGIN if is_right else Login("nao", "wr0ng-token"))
    with Robot(login=LOGIN) as robot, linked(robot, client=either, **login, acts=True) as (link, states):
        if is_right:
            states.wait_for("up")
            answer(link, "tickle")
            robot.calls.wait_for(lambda call: call.method == "say")
        else:
            states.wait_for("down")
            assert "check url, user and token" in caplog.text
        shown = repr([vars(link), states.told, caplog.text])
        assert LOGIN.token not in shown
        assert "wr0ng-token" not in shown


@pytest.mark.parametrize("encrypted", [True, False])
def test_tcp_and_tcps_mixed_up_gives_advice(
    encrypted: bool, either: str, caplog: pytest.LogCaptureFixture
) -> None:
    with Robot(login=LOGIN if encrypted else None) as robot:
        url = robot.url.replace("tcps://", "tcp://") if encrypted else robot.url.replace("tcp://", "tcps://")
        with linked(robot, client=either, url=url) as (_, states):
            states.wait_for("down")
            assert "tcp:// or tcps://" in caplog.text


def test_publishing_to_a_hung_robot_returns_at_once(either: str) -> None:
    limits = replace(IMPATIENT, capacity=5, stale_s=60)
    with Robot() as robot, linked(robot, client=either, limits=limits, acts=True) as (link, states):
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
def test_stopping_ends_soon_and_leaves_no_thread(state: str, either: str) -> None:
    with (
        Robot(say_s=60) as robot,
        linked(robot, client=either, limits=IMPATIENT, acts=True) as (link, states),
    ):
        states.wait_for("up")
        if state == "busy":
            answer(link)
            robot.calls.wait_for(lambda call: call.method == "say")
        elif state == "killed":
            robot.stop()
            states.wait_for("up", "down")
        elif state != "up":
            robot.hang()
            link.put(*message())
        if state == "hung-connect":
            states.wait_for("up", "down")
        started_s = time.monotonic()
        link.stop()
        assert time.monotonic() - started_s < AT_ONCE_S
        assert link_threads() == []


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
        robot.stop()
        robot.start()
        wait_for(lambda: "robot.token_file" in caplog.text)
        login_in(tmp_path, renewed)
        states.wait_for("up", "down", "up")
        hears(robot, link)


def test_the_doctor_shows_the_certificate_to_pin(tmp_path: Path) -> None:
    with Robot(login=LOGIN) as robot:
        sent = ssl.get_server_certificate(("127.0.0.1", int(robot.url.rpartition(":")[2])))
        shown = f"sha256:{hashlib.sha256(ssl.PEM_cert_to_DER_cert(sent)).hexdigest()}"
        pin = f"if it is your robot, set robot.certificate: {shown}"
        without = check_robot(Settings(robot=RobotSettings(url=robot.url)))
        assert (without.verdict, without.advice.endswith(pin)) == ("to do", True)
        trusted = check_robot(Settings(robot=RobotSettings(url=robot.url, **login_in(tmp_path))))
        assert (trusted.verdict, trusted.advice) == ("ok", pin)
        pinned = RobotSettings(url=robot.url, **login_in(tmp_path) | {"certificate": shown})
        assert check_robot(Settings(robot=pinned)).advice == ""
