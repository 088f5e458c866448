"""From bytes on a serial port to lines on standard output: the spawned daemon, a pty, recordings."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from rigs.expectations import LENGTHS, RECORDINGS, answers, expected, outline, stream_of
from rigs.haart_folder import needs_haart, recordings_of
from rigs.line_faults import Faults
from rigs.patient_port import PATIENT, PatientPort
from rigs.robots import Robot
from rigs.running_daemon import run_daemon

from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.path.events import Event, Prediction, TouchBegan, TouchEnded
from touchd.daemon.playback.rig import encoder_for
from touchd.daemon.playback.stream import with_quiet
from touchd.drivers.recording import (
    Recording,
    Stream,
    read_recordings,
    realign,
)
from touchd.drivers.robot.session import RobotSettings
from touchd.model.classifier import Classifier

# Faster than real time: answers depend on the sensor's clock, not on the arrival.
SPEED = 100.0
BEGINNING = 650


def beginning(stream: Stream) -> Stream:
    """The first twelve seconds, which hold three short touches."""
    return Stream(stream.counts[:BEGINNING], stream.sensor_ms[:BEGINNING], ())


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., list[Event]]:
    """Plays a stream to the spawned daemon; returns its events."""

    def run(
        stream: Stream,
        *,
        protocol: str = "fabric-grid",
        faults: Faults | None = None,
        robot: RobotSettings | None = None,
    ) -> list[Event]:
        sensor = SensorSettings(format=protocol)
        with PatientPort(stream, encoder_for(sensor), speed=SPEED, faults=faults or Faults()) as port:
            sensor = msgspec.structs.replace(sensor, port=port.path)
            return run_daemon(Settings(sensor=sensor, robot=robot, scene=PATIENT), tmp_path, port)[0]

    return run


# `touchd classify` checks the gestures without a port, too.
SHIPPED = [
    pytest.param(path, id=path.name, marks=[] if path == LENGTHS else [pytest.mark.slow])
    for path in RECORDINGS
]


@pytest.mark.parametrize("recording", SHIPPED)
def test_shipped_recordings_give_the_expected_events(
    run: Callable[..., list[Event]], recording: Path
) -> None:
    assert outline(run(stream_of(recording))) == expected(recording)


@pytest.mark.parametrize(
    "line",
    [{"protocol": "csv"}, {"faults": Faults(chunk_bytes=40, garbage_every=31)}],
    ids=["lines of numbers", "bytes in pieces, garbage between frames"],
)
def test_another_line_gives_the_same_answers(
    run: Callable[..., list[Event]], classifier: Classifier, line: dict[str, object]
) -> None:
    stream = beginning(stream_of(LENGTHS))
    assert outline(run(stream, **line)) == outline(answers(stream, classifier))


def test_damaged_frames_mark_the_touches_degraded(
    run: Callable[..., list[Event]], classifier: Classifier
) -> None:
    stream = beginning(stream_of(LENGTHS))
    emitted = run(stream, faults=Faults(flip_bit_every=50))
    result, sent = (
        [event.touch for event in events if isinstance(event, TouchEnded)]
        for events in (emitted, answers(stream, classifier))
    )
    assert result == sent
    assert any(event.degraded for event in emitted if isinstance(event, Prediction))


def test_the_robot_gets_exactly_the_told_answers(run: Callable[..., list[Event]]) -> None:
    with Robot() as robot:
        emitted = run(beginning(stream_of(LENGTHS)), robot=RobotSettings(url=robot.url))
        told = [event.gesture for event in emitted if isinstance(event, Prediction) and event.told]
        assert told
        robot.calls.wait_for_raise("TouchGesture/Status", "down")
        assert robot.calls.raised("TouchGesture/Gesture") == told


def four_seconds_of(recording: Recording) -> Recording:
    return replace(recording, counts=recording.counts[:216], sensor_ms=recording.sensor_ms[:216])


@pytest.mark.slow
@needs_haart
def test_each_gestures_real_recording_is_one_touch(
    run: Callable[..., list[Event]], classifier: Classifier, tmp_path: Path
) -> None:
    path = recordings_of("training.csv", "P4,none,none,", tmp_path)
    recordings = [four_seconds_of(realign(recording)) for recording in read_recordings(path)]
    assert sorted(recording.gesture for recording in recordings) == sorted(classifier.labels)
    stream = with_quiet(recordings, [recording for recording in recordings if recording.gesture == "notouch"])
    emitted = run(stream)
    begins_ms = [event.sensor_ms for event in emitted if isinstance(event, TouchBegan)]
    touching = [span for span in stream.spans if span.gesture != "notouch"]
    assert begins_ms == pytest.approx([int(stream.sensor_ms[span.start]) for span in touching], abs=300)
    named = {
        span.gesture: [event for event in emitted if isinstance(event, Prediction) and event.touch == touch]
        for touch, span in enumerate(touching, 1)
    }
    for gesture, predictions in named.items():
        assert [event.stage for event in predictions][:3] == ["early", "revised", "final"]
        if gesture in ("constant", "pat"):
            assert {event.gesture for event in predictions} == {gesture}
