"""Events and actions on the robot: our session and qi's, each on our server and on qi's."""

import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from rigs.robots import CLIENTS, DETAIL, GESTURE, STATUS, Robot, answer, linked, message, needs_qi, say

from touchd.drivers.fakes import fake_robot
from touchd.drivers.robot.link import LIMITS, Act, RobotLink, client_of
from touchd.drivers.robot.session import RobotError, RobotRefused, RobotSession, RobotSettings


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


def test_an_answer_is_raised_under_the_prefix_and_removed_at_the_end(robot: Robot, client: str) -> None:
    with linked(robot, client=client, prefix="Pad") as (link, _):
        link.put(*message("stroke", confidence=0.75, time_s=1_790_000_000.25, touch=7, sequence=12))
        robot.calls.wait_for_raise("Pad/Gesture", "stroke")
        detail = ["stroke", 0.75, [1_790_000_000, 250_000], "early", 7, 12]
        assert robot.calls.raised("Pad/Detail") == [detail]
    robot.calls.wait_for(lambda call: (call.method, call.arguments) == ("removeData", ("Pad/Gesture",)))


def test_a_slow_robot_gets_every_detail_before_its_gesture(client: str) -> None:
    gestures = ["pat", "rub", "tickle"]
    with Robot(call_s=0.03) as robot, linked(robot, client=client) as (link, states):
        for touch, gesture in enumerate(gestures):
            link.put(*message(gesture, touch))
        robot.calls.wait_for_raise(GESTURE, gestures[-1])
        raised = [call.arguments for call in robot.calls.all() if call.arguments[0] in (GESTURE, DETAIL)]
        told = [(key, value[0] if isinstance(value, list) else value) for key, value in raised]
        assert told == [(key, gesture) for gesture in gestures for key in (DETAIL, GESTURE)]
        states.wait_for("up")


def test_the_robots_memory_holds_four_bytes(robot: Robot, client: str, session: RobotSession) -> None:
    session.call("ALMemory", "raiseEvent", "Pad/Float", 0.1, limit_s=5)
    for event, value in (("Pad/Int", 2**31), ("Pad/List", [1, [-(2**31) - 1]]), ("Pad/Float", 1e39)):
        with pytest.raises(RobotRefused, match=r"4 bytes|takes these arguments"):
            session.call("ALMemory", "raiseEvent", event, value, limit_s=5)
    assert robot.calls.raised("Pad/Float") == [float(np.float32(0.1))]
    with linked(robot, client=client) as (link, _):
        # Beyond 2038, and after more touches than there will be.
        link.put(*message("pat", confidence=0.5, time_s=2.0**33, touch=2**40, sequence=2**31))
        robot.calls.wait_for_raise(GESTURE, "pat")
        assert robot.calls.raised(DETAIL) == [["pat", 0.5, [0, 0], "early", 0, 0]]


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
def test_what_a_robot_cannot_do_is_refused_and_the_session_goes_on(
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
def test_a_qi_that_cannot_be_loaded_is_reported_in_one_line(
    content: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "qi.py").write_text(content)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "qi", raising=False)
    complaint = r"^robot\.client: qi cannot be loaded \(.*leave client out, or.*$"
    with pytest.raises(RobotError, match=complaint):
        RobotLink(RobotSettings(url="tcp://nao.local:9559", client="qi"))


@pytest.mark.parametrize("wrong", ["--port=99999", "--call-s=-1", "--say-s=nan", "--without=ALNothing"])
def test_the_fake_robot_command_refuses_invalid_options(
    wrong: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        fake_robot.main([wrong])
    assert wrong.partition("=")[0] in capsys.readouterr().err
