"""Events and actions on the robot; on real qi."""

import platform
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigs.robots import DETAIL, GESTURE, STATUS, Robot, answer, hears, linked, message

from touchd.drivers.fakes import fake_robot
from touchd.drivers.robot.acting import animated_say, run_behavior, say, set_leds
from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.session import QiSession, RobotError, RobotLimits, RobotRefused, RobotSettings


# Starting a process takes longer than most of the tests that talk to it.
@pytest.fixture(scope="module")
def running_robot() -> Iterator[Robot]:
    with Robot(say_s=0.05) as robot:
        yield robot


@pytest.fixture
def robot(running_robot: Robot) -> Iterator[Robot]:
    """A robot without earlier calls; after the test its link has ended."""
    calls = running_robot.calls
    yield running_robot
    if calls.raised(STATUS):
        calls.wait_for(lambda _: calls.raised(STATUS)[-1] == "down")
    calls.clear()


def test_an_answer_raises_gesture_and_detail_under_the_prefix(robot: Robot) -> None:
    with linked(robot, prefix="Pad") as (link, _):
        link.put(message("stroke", confidence=0.75, time_s=1_790_000_000.25, touch=7, sequence=12))
        robot.calls.wait_for_raise("Pad/Gesture", "stroke")
        detail = ["stroke", 0.75, [1_790_000_000, 250_000], "early", 7, 12]
        assert robot.calls.raised("Pad/Detail") == [detail]


def test_a_slow_robot_gets_every_detail_before_its_gesture() -> None:
    gestures = ["pat", "rub", "tickle"]
    with Robot(call_s=0.03) as robot, linked(robot) as (link, states):
        for touch, gesture in enumerate(gestures):
            link.put(message(gesture, touch))
        robot.calls.wait_for_raise(GESTURE, gestures[-1])
        raised = [call.arguments for call in robot.calls.all() if call.arguments[0] in (GESTURE, DETAIL)]
        told = [(key, value[0] if isinstance(value, list) else value) for key, value in raised]
        assert told == [(key, gesture) for gesture in gestures for key in (DETAIL, GESTURE)]
        states.wait_for("up")


def test_a_gesture_is_removed_a_second_after_the_last(robot: Robot) -> None:
    with linked(robot) as (link, _):
        link.put(message("stroke", 1))
        threading.Event().wait(0.2)
        link.put(message("pat", 2))
        removed = robot.calls.wait_for(lambda call: call.method == "removeData")
        assert removed.arguments == (GESTURE,)
        assert 0.9 < removed.time_s - robot.calls.wait_for_raise(GESTURE, "pat").time_s < 5.0
        assert [call.method for call in robot.calls.all()].count("removeData") == 1


def test_a_gesture_that_another_program_removed_delays_no_answer(robot: Robot) -> None:
    other = QiSession(robot.url, None, RobotLimits(), threading.Event())
    with linked(robot) as (link, _), closing(other):
        other.connect()
        hears(robot, link, "stroke")
        other.call("ALMemory", "removeData", GESTURE, limit_s=5.0)
        robot.calls.wait_for(lambda call: call.method == "removeData" and bool(call.refused))
        hears(robot, link, "pat")


def test_the_status_follows_the_pad(robot: Robot) -> None:
    with linked(robot) as (link, _):
        robot.calls.wait_for_raise(STATUS, "up")
        link.set_status("down")
        robot.calls.wait_for_raise(STATUS, "down")
        link.set_status("up")
        robot.calls.wait_for(lambda _: robot.calls.raised(STATUS) == ["up", "down", "up"])
    robot.calls.wait_for(lambda _: robot.calls.raised(STATUS) == ["up", "down", "up", "down"])


def test_stopping_removes_the_gesture_from_memory(robot: Robot) -> None:
    with linked(robot) as (link, _):
        link.put(message())
        robot.calls.wait_for_raise(GESTURE, "stroke")
    robot.calls.wait_for(lambda call: call.method == "removeData")


def test_every_value_sent_fits_the_robots_four_bytes(robot: Robot) -> None:
    with linked(robot) as (link, _):
        # Beyond 2038, and after more touches than there will be.
        link.put(message("pat", confidence=0.5, time_s=2.0**33, touch=2**40, sequence=2**31))
        robot.calls.wait_for_raise(GESTURE, "pat")
        assert robot.calls.raised(DETAIL) == [["pat", 0.5, [0, 0], "early", 0, 0]]


def test_a_stand_in_behaves_like_a_robots_memory(robot: Robot) -> None:
    session = QiSession(robot.url, None, RobotLimits(), threading.Event())
    session.connect()
    session.call("ALMemory", "raiseEvent", "Pad/Float", 0.1, limit_s=5)
    for event, value in (("Pad/Int", 2**31), ("Pad/List", [1, [-(2**31) - 1]]), ("Pad/Float", 1e39)):
        with pytest.raises(RobotRefused, match="4 bytes"):
            session.call("ALMemory", "raiseEvent", event, value, limit_s=5)
    session.close()
    robot.calls.wait_for(lambda call: "4 bytes" in call.refused and call.arguments[0] == "Pad/Float")
    assert robot.calls.raised("Pad/Float") == [float(np.float32(0.1))]


def test_acts_are_carried_out_in_order(robot: Robot) -> None:
    hey = "animations/Stand/Gestures/Hey_1"
    acts = [set_leds("FaceLeds", 0xFF8000, 0.5), animated_say("A tickle!"), run_behavior(hey), say("Done")]
    with linked(robot, acts=True) as (link, _):
        link.act(acts)
        robot.calls.wait_for(lambda call: call.service == "ALTextToSpeech")
        done = [(call.service, call.arguments) for call in robot.calls.all() if call.service != "ALMemory"]
        assert done == [
            ("ALLeds", ("FaceLeds", 0xFF8000, 0.5)),
            ("ALAnimatedSpeech", ("A tickle!",)),
            ("ALBehaviorManager", (hey,)),
            ("ALTextToSpeech", ("Done",)),
        ]


def test_speech_that_takes_long_delays_no_event() -> None:
    with Robot(say_s=60) as robot, linked(robot, acts=True) as (link, _):
        answer(link, "stroke", 1)
        robot.calls.wait_for(lambda call: call.method == "say")
        link.put(message("pat", 2))
        robot.calls.wait_for_raise(GESTURE, "pat")
        assert len(robot.calls.said()) == 1


def test_unsupported_actions_are_skipped(caplog: pytest.LogCaptureFixture) -> None:
    with Robot(without=["ALAnimatedSpeech"]) as robot, linked(robot, acts=True) as (link, states):
        for gesture in ("stroke", "pat"):
            link.act([run_behavior("nosuch"), animated_say("no"), say(gesture)])
        robot.calls.wait_for(lambda call: call.arguments == ("pat",))
        states.wait_for("up")
    warnings = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(warnings) == 1
    assert "nosuch" in warnings[0]
    assert "ALAnimatedSpeech" in warnings[0]
    assert robot.calls.said() == ["stroke", "pat"]


@pytest.mark.parametrize(
    ("python", "advice"), [((3, 12), ".*pip install"), ((3, 14), "`touchd docs install` tells how")]
)
def test_without_qi_a_configured_robot_is_reported_in_one_line(
    monkeypatch: pytest.MonkeyPatch, python: tuple[int, int], advice: str
) -> None:
    monkeypatch.setitem(sys.modules, "qi", None)
    monkeypatch.setattr(sys, "version_info", python)
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    with pytest.raises(
        RobotError, match=rf"qi, the library that speaks to NAOqi, is not installed; {advice}"
    ) as error:
        RobotLink(RobotSettings(url="tcp://nao.local:9559"))
    assert "\n" not in str(error.value)


def test_a_qi_that_cannot_be_loaded_is_reported_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "qi.py").write_text("raise ImportError('libqi.so: no such file')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "qi", raising=False)
    with pytest.raises(RobotError, match=r"NAOqi, cannot be loaded \(libqi\.so: no such file\); "):
        RobotLink(RobotSettings(url="tcp://nao.local:9559"))


@pytest.mark.parametrize("content", ["print 'hello'", "raise ImportError('undefined symbol: PyString_Type')"])
def test_the_qi_of_an_sdk_for_python_2_on_pythonpath_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str
) -> None:
    (tmp_path / "qi").mkdir()
    (tmp_path / "qi/__init__.py").write_text(content)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", f"/opt/other:{tmp_path}")
    monkeypatch.delitem(sys.modules, "qi", raising=False)
    with pytest.raises(
        RobotError, match=rf"leads to another one, {tmp_path}/qi/__init__.py, .*; unset PYTHON"
    ):
        RobotLink(RobotSettings(url="tcp://nao.local:9559"))


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"url": "nao.local:9559"}, "is not an address such as tcp://"),
        ({"url": "tcp://nao.local"}, "lacks its port, usually 9559: tcp://nao.local:9559"),
        ({"url": "tcps://nao"}, "lacks its port, usually 9503: tcps://nao:9503"),
        ({"url": "tcp://nao.local:port"}, "is not an address such as tcp://"),
        ({"url": "tcp://nao.local:70000"}, "is not an address such as tcp://"),
        ({"url": "tcps://nao:9503", "user": "nao"}, "set token_file"),
        ({"url": "tcps://nao:9503", "token_file": "/dev/null"}, "no user"),
        ({"url": "tcp://nao:9559", "user": "nao", "token_file": "/dev/null"}, "unencrypted; use tcps://"),
        (
            {"url": "tcps://nao:9503", "user": "nao", "token_file": "/no/such"},
            r"/no/such cannot be read \(No such",
        ),
        ({"url": "tcps://nao:9503", "user": "nao", "token_file": "/dev/zero"}, "larger than 4096 bytes"),
        ({"url": "tcps://nao:9503", "user": "nao", "token_file": "/dev/null"}, "/dev/null is empty"),
    ],
)
def test_a_failed_login_is_reported_in_one_line(settings: dict[str, Any], complaint: str) -> None:
    with pytest.raises(RobotError, match=complaint):
        RobotLink(RobotSettings(**settings), open_session=lambda *_: pytest.fail("a session was opened"))


@pytest.mark.parametrize("wrong", ["--port=99999", "--call-s=-1", "--say-s=nan", "--without=ALNothing"])
def test_the_fake_robot_command_refuses_invalid_options(
    wrong: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as exit_code:
        fake_robot.main([wrong])
    assert exit_code.value.code == 2
    assert wrong.partition("=")[0] in capsys.readouterr().err
