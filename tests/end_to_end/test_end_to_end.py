"""The spawned daemon on a pty, from bytes to lines, at the pad's rate and far beyond it."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest
from rigs import pairs
from rigs.expectations import (
    FOLDER,
    LENGTHS,
    RECORDINGS,
    answers,
    beginning_of,
    expectation_of,
    expected,
    outline,
    stream_of,
)
from rigs.patient_port import PATIENT, PatientPort
from rigs.robots import Robot
from rigs.running_daemon import run_daemon, totals
from rigs.service_manager import Manager
from rigs.wait import WITHIN_S

from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.path.events import Event, Prediction, TouchBegan
from touchd.daemon.playback.rig import SpawnedDaemon, encoder_for
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.recording import (
    Stream,
    read_recordings,
    splice,
)
from touchd.drivers.robot.session import RobotSettings
from touchd.model.classifier import Classifier

# Faster than real time: answers depend on the sensor's clock, not on the arrival.
SPEED = 100.0


def run(stream: Stream, folder: Path, sensor: SensorSettings, **settings: Any) -> list[Event]:
    """Play a stream to the spawned daemon; return its events."""
    with PatientPort(stream, encoder_for(sensor), speed=SPEED) as port:
        sensor = msgspec.structs.replace(sensor, port=port.path)
        return run_daemon(Settings(sensor=sensor, scene=PATIENT, **settings), folder, port)[0]


# `touchd classify` checks the gestures without a port, too.
SHIPPED = [
    pytest.param(path, id=path.name, marks=[] if path == LENGTHS else [pytest.mark.slow])
    for path in RECORDINGS
]


@pytest.mark.parametrize("recording", SHIPPED)
def test_shipped_recordings_give_the_expected_events(recording: Path, tmp_path: Path) -> None:
    assert outline(run(stream_of(recording), tmp_path, SensorSettings())) == expected(recording)


def test_the_robot_gets_exactly_the_told_answers(classifier: Classifier, tmp_path: Path) -> None:
    stream = beginning_of(LENGTHS, 3)
    with Robot() as robot:
        emitted = run(stream, tmp_path, SensorSettings(format="csv"), robot=RobotSettings(url=robot.url))
        assert outline(emitted) == outline(answers(stream, classifier))
        told = [event.gesture for event in emitted if isinstance(event, Prediction) and event.told]
        robot.calls.wait_for_raise("TouchGesture/Status", "down")
        assert robot.calls.raised("TouchGesture/Gesture") == told != []


@pytest.fixture
def busy() -> Iterator[None]:
    """Keep every core busy."""
    burners = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 2)
    ]
    yield
    for burner in burners:
        burner.kill()
        burner.wait()


@pytest.mark.slow
@pytest.mark.usefixtures("busy")
def test_no_frame_is_lost_on_busy_cores(tmp_path: Path) -> None:
    with FakePort(stream_of(LENGTHS), encoder_for(SensorSettings())) as port:
        events, log = run_daemon(Settings(sensor=SensorSettings(port=port.path)), tmp_path, port, within_s=90)
    processed, _, dropped = totals(log)
    assert (processed, dropped) == (len(stream_of(LENGTHS).counts), 0)
    assert outline(events) == expected(LENGTHS)
    slowest_ms = max(event.latency_ms for event in events if isinstance(event, Prediction))
    sys.stdout.write(f"{processed} frames, {dropped} dropped, slowest answer {slowest_ms:.1f} ms\n")


HELD_UP_TURNS, TURNS, FAST = 8, 16, 10.0


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_after_an_overrun_losses_are_counted_and_answers_right(tmp_path: Path) -> None:
    # The daemon is stopped for eight repetitions of the recording, then gets them as fast as the line allows.
    stream = splice(read_recordings(LENGTHS) * TURNS)
    held_up_s = HELD_UP_TURNS * len(stream.counts) / TURNS / FRAME_RATE_HZ / FAST
    with (
        closing(Manager(tmp_path)) as manager,
        FakePort(stream, encoder_for(SensorSettings()), speed=FAST) as port,
        (tmp_path / "log").open("w+") as log,
    ):
        settings = Settings(sensor=SensorSettings(port=port.path))
        daemon = SpawnedDaemon(settings, tmp_path, log.buffer, manager.environ)
        manager.await_ready()
        daemon.process.send_signal(signal.SIGSTOP)
        assert not port.wait(held_up_s)
        daemon.process.send_signal(signal.SIGCONT)
        assert port.wait(WITHIN_S)
        daemon.process.terminate()
        events = list(daemon.events())
        assert daemon.stop() == 0
        statuses = manager.received()
        log.seek(0)
        said = log.read()
    processed, _, dropped = totals(said)
    assert dropped > 0
    assert processed + dropped == len(stream.counts)
    assert "frames dropped: the machine is too busy, or the pad sends too many" in said
    assert any(re.search(r"frames/s, \d+ touches, [1-9]\d* frames dropped", status) for status in statuses)
    assert _last_turn(events) == _last_turn(answers(stream, Classifier.load()))
    sys.stdout.write(f"held up for {held_up_s:.0f} s: {processed} frames, {dropped} dropped\n")


def _last_turn(events: list[Event]) -> list[dict[str, object]]:
    """Return the outline of the last repetition's touches, numbered from 1."""
    touches = max(int(str(entry["touch"])) for entry in expected(LENGTHS))
    before = max(event.touch for event in events if isinstance(event, TouchBegan)) - touches
    last = [entry | {"touch": int(str(entry["touch"])) - before} for entry in outline(events)]
    return [entry for entry in last if entry["touch"] >= 1]


@pytest.mark.parametrize("path", pairs.paths(), ids=lambda path: path.name.partition(".")[0])
def test_a_stream_gives_its_expected_events(path: Path, classifier: Classifier) -> None:
    assert pairs.output_of(path, classifier) == expected(path)


def test_every_stream_has_its_expected_events() -> None:
    assert len(pairs.paths()) >= 30
    assert [path.name for path in pairs.paths() if not expectation_of(path).exists()] == []


def test_a_command_adds_a_stream_with_its_expected_events(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tap = FOLDER / "touch-brief-tap.csv.gz"
    shipped = expected(tap)
    for module in ("expectations", "pairs"):
        monkeypatch.setattr(f"rigs.{module}.FOLDER", tmp_path)
    monkeypatch.setattr(pairs, "RECORDINGS", ())
    pairs.main(["--add", str(tap)])
    assert expected(tmp_path / tap.name) == shipped
