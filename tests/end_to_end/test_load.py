"""The real daemon under load, at the pad's rate and far beyond it.

To see the figures: pytest -m slow tests/end_to_end/test_load.py -s
"""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from rigs.expectations import LENGTHS, answers, expected, outline, stream_of
from rigs.running_daemon import run_daemon, totals
from rigs.service_manager import Manager

from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.path.events import Event, Prediction, TouchBegan
from touchd.daemon.playback.rig import SpawnedDaemon, encoder_for
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.recording import read_recordings, splice
from touchd.model.classifier import Classifier

Play = Callable[[float], tuple[list[Event], int, int]]


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


@pytest.fixture
def play(tmp_path: Path) -> Play:
    """Plays a recording to the daemon at a speed; returns events, frames processed and dropped."""

    def play(speed: float) -> tuple[list[Event], int, int]:
        with FakePort(stream_of(LENGTHS), encoder_for(SensorSettings()), speed=speed) as port:
            settings = Settings(sensor=SensorSettings(port=port.path))
            events, log = run_daemon(settings, tmp_path, port, within_s=90)
        processed, _, dropped = totals(log)
        return events, processed, dropped

    return play


def test_the_final_counts_add_up(play: Play) -> None:
    _, processed, dropped = play(100.0)
    assert processed + dropped == len(stream_of(LENGTHS).counts)


@pytest.mark.slow
@pytest.mark.usefixtures("busy")
def test_no_frame_is_lost_on_busy_cores(play: Play) -> None:
    events, processed, dropped = play(1.0)
    assert (processed, dropped) == (len(stream_of(LENGTHS).counts), 0)
    assert outline(events) == expected(LENGTHS)
    slowest_ms = max(event.latency_ms for event in events if isinstance(event, Prediction))
    sys.stdout.write(f"1 times: {processed} frames, {dropped} dropped, slowest answer {slowest_ms:.1f} ms\n")


HELD_UP_TURNS, TURNS, SPEED = 8, 16, 10.0


@pytest.mark.slow
def test_after_an_overrun_losses_are_counted_and_answers_right(tmp_path: Path) -> None:
    # The daemon is stopped for eight repetitions of the recording, then gets them as fast as the line allows.
    stream = splice(read_recordings(LENGTHS) * TURNS)
    held_up_s = HELD_UP_TURNS * len(stream.counts) / TURNS / FRAME_RATE_HZ / SPEED
    with (
        closing(Manager(tmp_path)) as manager,
        FakePort(stream, encoder_for(SensorSettings()), speed=SPEED) as port,
        (tmp_path / "log").open("w+") as log,
    ):
        settings = Settings(sensor=SensorSettings(port=port.path))
        daemon = SpawnedDaemon(settings, tmp_path, log.buffer, manager.environ)
        manager.await_ready()
        daemon.process.send_signal(signal.SIGSTOP)
        assert not port.wait(held_up_s)
        daemon.process.send_signal(signal.SIGCONT)
        assert port.wait(60)
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
