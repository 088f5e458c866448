"""Events and actions on the robot: our session and qi's, each on our server and on qi's."""

import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from rigs.robots import CLIENTS, DETAIL, GESTURE, STATUS, Robot, answer, hears, linked, message, needs_qi

from touchd.drivers.fakes import fake_robot
from touchd.drivers.robot.acting import animated_say, run_behavior, say, set_leds
from touchd.drivers.robot.link import RobotLink, client_of
from touchd.drivers.robot.session import (
    RobotError,
    RobotLimits,
    RobotRefused,
    RobotSession,
    RobotSettings,
)


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


def opened(robot: Robot, client: str) -> RobotSession:
    settings = RobotSettings(url=robot.url, client=client)  # type: ignore[arg-type]
    session = client_of(settings)(settings, RobotLimits(), threading.Event())
    session.connect()
    return session


@pytest.fixture
def robot(running_robot: Robot) -> Iterator[Robot]:
    """A robot without earlier calls; after the test its link has ended."""
    calls = running_robot.calls
    yield running_robot
    if calls.raised(STATUS):
        calls.wait_for(lambda _: calls.raised(STATUS)[-1] == "down")
    calls.clear()


def test_an_answer_raises_gesture_and_detail_under_the_prefix(robot: Robot, client: str) -> None:
    with linked(robot, client=client, prefix="Pad") as (link, _):
        link.put(message("stroke", confidence=0.75, time_s=1_790_000_000.25, touch=7, sequence=12))
        robot.calls.wait_for_raise("Pad/Gesture", "stroke")
        detail = ["stroke", 0.75, [1_790_000_000, 250_000], "early", 7, 12]
        assert robot.calls.raised("Pad/Detail") == [detail]


def test_a_slow_robot_gets_every_detail_before_its_gesture(client: str) -> None:
    gestures = ["pat", "rub", "tickle"]
    with Robot(call_s=0.03) as robot, linked(robot, client=client) as (link, states):
        for touch, gesture in enumerate(gestures):
            link.put(message(gesture, touch))
        robot.calls.wait_for_raise(GESTURE, gestures[-1])
        raised = [call.arguments for call in robot.calls.all() if call.arguments[0] in (GESTURE, DETAIL)]
        told = [(key, value[0] if isinstance(value, list) else value) for key, value in raised]
        assert told == [(key, gesture) for gesture in gestures for key in (DETAIL, GESTURE)]
        states.wait_for("up")


def test_a_gesture_is_removed_a_second_after_the_last(robot: Robot, client: str) -> None:
    with linked(robot, client=client) as (link, _):
        link.put(message("stroke", 1))
        threading.Event().wait(0.2)
        link.put(message("pat", 2))
        removed = robot.calls.wait_for(lambda call: call.method == "removeData")
        assert removed.arguments == (GESTURE,)
        assert 0.9 < removed.time_s - robot.calls.wait_for_raise(GESTURE, "pat").time_s < 5.0
        assert [call.method for call in robot.calls.all()].count("removeData") == 1


def test_a_gesture_that_another_program_removed_delays_no_answer(robot: Robot, client: str) -> None:
    with linked(robot, client=client) as (link, _), closing(opened(robot, client)) as other:
        hears(robot, link, "stroke")
        other.call("ALMemory", "removeData", GESTURE, limit_s=5.0)
        robot.calls.wait_for(lambda call: call.method == "removeData" and bool(call.refused))
        hears(robot, link, "pat")


def test_the_status_follows_the_pad(robot: Robot, client: str) -> None:
    with linked(robot, client=client) as (link, _):
        robot.calls.wait_for_raise(STATUS, "up")
        link.set_status("down")
        robot.calls.wait_for_raise(STATUS, "down")
        link.set_status("up")
        robot.calls.wait_for(lambda _: robot.calls.raised(STATUS) == ["up", "down", "up"])
    robot.calls.wait_for(lambda _: robot.calls.raised(STATUS) == ["up", "down", "up", "down"])


def test_stopping_removes_the_gesture_from_memory(robot: Robot, client: str) -> None:
    with linked(robot, client=client) as (link, _):
        link.put(message())
        robot.calls.wait_for_raise(GESTURE, "stroke")
    robot.calls.wait_for(lambda call: call.method == "removeData")


def test_every_value_sent_fits_the_robots_four_bytes(robot: Robot, client: str) -> None:
    with linked(robot, client=client) as (link, _):
        # Beyond 2038, and after more touches than there will be.
        link.put(message("pat", confidence=0.5, time_s=2.0**33, touch=2**40, sequence=2**31))
        robot.calls.wait_for_raise(GESTURE, "pat")
        assert robot.calls.raised(DETAIL) == [["pat", 0.5, [0, 0], "early", 0, 0]]


def test_a_stand_in_behaves_like_a_robots_memory(robot: Robot, client: str) -> None:
    with closing(opened(robot, client)) as session:
        session.call("ALMemory", "raiseEvent", "Pad/Float", 0.1, limit_s=5)
        for event, value in (("Pad/Int", 2**31), ("Pad/List", [1, [-(2**31) - 1]]), ("Pad/Float", 1e39)):
            with pytest.raises(RobotRefused, match="4 bytes"):
                session.call("ALMemory", "raiseEvent", event, value, limit_s=5)
    robot.calls.wait_for(lambda call: "4 bytes" in call.refused and call.arguments[0] == "Pad/Float")
    assert robot.calls.raised("Pad/Float") == [float(np.float32(0.1))]


@pytest.mark.parametrize(
    "value", [[], [[1.5, "Strähne", True], -(2**31)], "", "\N{WAVING HAND SIGN}", 0, False]
)
def test_a_value_comes_back_as_it_was_sent(robot: Robot, client: str, value: object) -> None:
    with closing(opened(robot, client)) as session:
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
    robot: Robot, client: str, service: str, method: str, arguments: tuple[object, ...], complaint: str
) -> None:
    with closing(opened(robot, client)) as session:
        with pytest.raises(RobotRefused, match=complaint):
            session.call(service, method, *arguments, limit_s=5)
        assert session.call("ALSystem", "systemVersion", limit_s=5) == "2.8.7.4"


def test_acts_are_carried_out_in_order(robot: Robot, client: str) -> None:
    hey = "animations/Stand/Gestures/Hey_1"
    acts = [set_leds("FaceLeds", 0xFF8000, 0.5), animated_say("A tickle!"), run_behavior(hey), say("Done")]
    with linked(robot, client=client, acts=True) as (link, _):
        link.act(acts)
        robot.calls.wait_for(lambda call: call.service == "ALTextToSpeech")
        done = [(call.service, call.arguments) for call in robot.calls.all() if call.service != "ALMemory"]
        assert done == [
            ("ALLeds", ("FaceLeds", 0xFF8000, 0.5)),
            ("ALAnimatedSpeech", ("A tickle!",)),
            ("ALBehaviorManager", (hey,)),
            ("ALTextToSpeech", ("Done",)),
        ]


def test_speech_that_takes_long_delays_no_event(client: str) -> None:
    with Robot(say_s=60) as robot, linked(robot, client=client, acts=True) as (link, _):
        answer(link, "stroke", 1)
        robot.calls.wait_for(lambda call: call.method == "say")
        link.put(message("pat", 2))
        robot.calls.wait_for_raise(GESTURE, "pat")
        assert len(robot.calls.said()) == 1


def test_unsupported_actions_are_skipped(caplog: pytest.LogCaptureFixture, client: str) -> None:
    with (
        Robot(without=["ALAnimatedSpeech"]) as robot,
        linked(robot, client=client, acts=True) as (link, states),
    ):
        for gesture in ("stroke", "pat"):
            link.act([run_behavior("nosuch"), animated_say("no"), say(gesture)])
        robot.calls.wait_for(lambda call: call.arguments == ("pat",))
        states.wait_for("up")
    warnings = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(warnings) == 1
    assert "nosuch" in warnings[0]
    assert "ALAnimatedSpeech" in warnings[0]
    assert robot.calls.said() == ["stroke", "pat"]


@pytest.mark.parametrize("content", ["print 'hello'", "raise ImportError('libqi.so: no such file')"])
def test_a_qi_that_cannot_be_loaded_is_reported_in_one_line(
    content: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "qi.py").write_text(content)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "qi", raising=False)
    with pytest.raises(
        RobotError, match=r"robot\.client: qi cannot be loaded \(.*leave client out, or"
    ) as error:
        RobotLink(RobotSettings(url="tcp://nao.local:9559", client="qi"))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("wrong", ["--port=99999", "--call-s=-1", "--say-s=nan", "--without=ALNothing"])
def test_the_fake_robot_command_refuses_invalid_options(
    wrong: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as exit_code:
        fake_robot.main([wrong])
    assert exit_code.value.code == 2
    assert wrong.partition("=")[0] in capsys.readouterr().err
