"""SIGHUP: the configuration is read again, nothing of the stream is lost, a wrong one changes nothing."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from rigs.expectations import expected, stream_of
from rigs.running_daemon import LENGTHS, SPEED, Daemon

from daemon.config import JournalSettings, RobotConfig, SceneSettings, SensorSettings, Settings
from daemon.decide import DecisionSettings
from daemon.destinations import encoder_for
from daemon.events import Event, Prediction, SensorEvent, TouchBegan, TouchEnded, decode
from daemon.pipeline import Pipeline, PipelineSettings
from daemon.playback.rig import outline
from daemon.reread import rereading
from daemon.service import load_model
from daemon.touch import TouchSettings
from drivers.errors import TouchdError
from drivers.fakes.fake_port import FakePort
from drivers.fakes.fake_robot import LoopbackRobot
from drivers.frame import Frame
from drivers.robot.session import qi_installed


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    daemon = Daemon(tmp_path)
    # Before it hears the pad it may not be listening to signals yet.
    daemon.await_event(SensorEvent)
    yield daemon
    daemon.close()


def test_a_wrong_configuration_is_refused_in_one_line_and_costs_nothing(daemon: Daemon) -> None:
    daemon.write("scene: {speak_abov: 0.5}")
    daemon.await_log(1)
    daemon.configure(scene=SceneSettings(gestures=("tap",)))
    daemon.await_log(2)
    daemon.configure(journal=JournalSettings(path="/nowhere/events.jsonl"))
    daemon.await_log(3)
    daemon.configure(robot=RobotConfig(url="nao"))
    daemon.await_log(4)
    assert outline(daemon.finish()) == expected(LENGTHS)
    for line, why in zip(
        daemon.log(),
        ["scene.speak_abov is not a setting", "tap is no gesture", "cannot be written", "not an address"],
        strict=True,
    ):
        assert line.startswith("WARNING daemon.reread: the new configuration is refused")
        assert why in line


def test_other_settings_count_at_once_and_no_frame_and_no_number_is_lost(
    daemon: Daemon, tmp_path: Path
) -> None:
    first, second = tmp_path / "first.jsonl", tmp_path / "second.jsonl"
    daemon.configure(journal=JournalSettings(path=str(first)))
    daemon.await_log(1)
    daemon.await_event(TouchEnded)
    daemon.configure(journal=JournalSettings(path=str(second)), scene=SceneSettings(speak_above=1.0))
    daemon.await_log(2)
    events = daemon.finish()
    assert [line.rpartition("changed: ")[2] for line in daemon.log()] == ["journal", "scene, journal"]
    assert [event.touch for event in events if isinstance(event, TouchBegan)] == list(
        range(1, 1 + sum(line["type"] == "touch_began" for line in expected(LENGTHS)))
    )
    kept = [decode(line) for file in (first, second) for line in file.read_bytes().splitlines()]
    assert kept == events[-len(kept) :]
    assert second.stat().st_size > 0
    later = [
        event for event in map(decode, second.read_bytes().splitlines()) if isinstance(event, Prediction)
    ]
    assert {event.told for event in later if event.stage in ("early", "revised") and event.touch > 2} == {
        False
    }


def test_another_port_is_read_from_then_on(daemon: Daemon) -> None:
    with FakePort(stream_of(LENGTHS), encoder_for(SensorSettings()), speed=SPEED) as other:
        daemon.configure(sensor=SensorSettings(port=other.path))
        while not any(isinstance(e, SensorEvent) and other.path in e.reason for e in daemon.events):
            daemon.await_event(SensorEvent)
        daemon.await_event(TouchEnded)
        states = [event for event in daemon.events if isinstance(event, SensorEvent)]
        assert [state.state for state in states][-2:] == ["down", "up"]
        assert other.path in states[-1].reason


@pytest.mark.skipif(not qi_installed(), reason="qi is not installed")
def test_a_robot_configured_later_is_told_from_then_on_and_one_left_out_is_told_goodbye(
    daemon: Daemon,
) -> None:
    with LoopbackRobot() as robot:
        daemon.configure(robot=RobotConfig(url=robot.url))
        robot.calls.wait_for_raise("TouchGesture/Status", "up")
        robot.calls.wait_for(lambda call: "TouchGesture/Gesture" in call.arguments)
        daemon.configure()
        robot.calls.wait_for_raise("TouchGesture/Status", "down")
    touches = [event.touch for event in daemon.finish() if isinstance(event, TouchBegan)]
    assert touches == list(range(1, len(touches) + 1))


def test_settings_count_from_the_next_touch_on_and_rest_stays_known() -> None:
    classifier = load_model(Settings())
    events: list[Event] = []
    pipeline = Pipeline(PipelineSettings(), classifier, events.append)
    stream = stream_of(LENGTHS)
    later = PipelineSettings(
        touch=TouchSettings(quiet_s=0.7), decision=DecisionSettings(answer_at_frames=(20, 30, 200))
    )
    for number, (ms, counts) in enumerate(zip(stream.sensor_ms.tolist(), stream.counts, strict=True)):
        before = len(events)
        pipeline.on_frame(Frame(number, ms, 0.0, counts))
        began = [event for event in events[before:] if isinstance(event, TouchBegan)]
        if began and began[0].touch == 3:
            pipeline.change(later, classifier)
    pipeline.flush()
    asked = {
        touch: {event.frames for event in events if isinstance(event, Prediction) and event.touch == touch}
        for touch in (3, 4)
    }
    assert 54 in asked[3]
    assert {20, 30} <= asked[4]
    assert [event.touch for event in events if isinstance(event, TouchEnded)] == list(range(1, 7))


def test_a_failure_nobody_foresaw_ends_neither_the_thread_nor_the_daemon(
    caplog: pytest.LogCaptureFixture,
) -> None:
    asked, done = threading.Event(), threading.Semaphore(0)
    results: Iterator[Callable[[], list[str]]] = iter([lambda: [1 / 0 and ""], lambda: ["scene"]])

    def change(settings: Settings) -> list[str]:
        done.release()
        return next(results)()

    with caplog.at_level("INFO"), rereading(asked, Settings, change):
        for _ in range(2):
            asked.set()
            assert done.acquire(timeout=5)
    assert "touchd-reread" not in [thread.name for thread in threading.enumerate()]
    assert "ZeroDivisionError" in caplog.text
    assert caplog.messages[-1] == "configuration read again; changed: scene"


def test_what_cannot_be_read_is_not_tried() -> None:
    def wrong() -> Settings:
        raise TouchdError("no such file")

    asked, read = threading.Event(), threading.Event()

    def reading() -> Settings:
        read.set()
        return wrong()

    with rereading(asked, reading, lambda _: pytest.fail("was changed")):
        asked.set()
        assert read.wait(5)
