"""A pad that breaks is told in the daemon's log: once when it begins, once when it is over."""

import logging
from pathlib import Path

import pytest
from rigs.made_pad import MadePad, nothing
from rigs.patient_port import playing
from rigs.running_daemon import run_daemon

from daemon.config import SensorSettings, Settings
from daemon.events import SensorEvent
from drivers.frame import FRAME_RATE_HZ, Counts, Frame
from drivers.pad.watch import LASTS_S, SAME_TROUBLE_S, PadWatch
from drivers.recording import Stream, ideal_clock_ms

BROKEN = "row 7 of the pad stands still: a broken wire?"
SPEED = 100.0


def pad(seconds: float, broken: tuple[tuple[float, float], ...]) -> Counts:
    """A pad at rest whose seventh row is dead from each of these seconds to the other."""
    counts = MadePad(3).counts(nothing(seconds))
    for begin_s, end_s in broken:
        counts[round(begin_s * FRAME_RATE_HZ) : round(end_s * FRAME_RATE_HZ), 6] = 0
    return counts


def told(counts: Counts, caplog: pytest.LogCaptureFixture) -> list[tuple[int, str, str]]:
    """What is logged of such a pad: the second, the level and the words."""
    caplog.set_level(logging.INFO)
    watch = PadWatch()
    said: list[tuple[int, str, str]] = []
    for number, (ms, pressure) in enumerate(zip(ideal_clock_ms(len(counts)).tolist(), counts, strict=True)):
        watch.update(Frame(number, ms, ms / 1000, pressure))
        said += [(ms // 1000, record.levelname, record.message) for record in caplog.records]
        caplog.clear()
    return said


def test_a_dead_row_and_its_return_are_told_once(tmp_path: Path) -> None:
    counts = pad(32, ((4, 20),))
    stream = Stream(counts, ideal_clock_ms(len(counts)), ())
    with playing(stream, SPEED) as port:
        events, said = run_daemon(Settings(sensor=SensorSettings(port=port.path)), tmp_path, port)
    lines = [line for line in said.splitlines() if "pad.watch" in line]
    assert lines == [f"WARNING drivers.pad.watch: {BROKEN}", f"INFO drivers.pad.watch: no longer: {BROKEN}"]
    assert {type(event) for event in events} <= {SensorEvent}


def test_a_loose_wire_is_told_once_in_ten_minutes(caplog: pytest.LogCaptureFixture) -> None:
    counts = pad(300, tuple((begin_s, begin_s + 12) for begin_s in range(5, 280, 30)))
    assert [line[1:] for line in told(counts, caplog)] == [
        ("WARNING", BROKEN),
        ("INFO", f"no longer: {BROKEN}"),
    ]


def test_a_wire_that_breaks_again_is_told_again(caplog: pytest.LogCaptureFixture) -> None:
    first, again = told(pad(150, ((5, 20), (40, 150))), caplog)[::2]
    assert (first[1:], again[1:]) == (("WARNING", BROKEN), ("WARNING", BROKEN))
    assert 40 + LASTS_S < again[0] < 40 + LASTS_S + 15 < SAME_TROUBLE_S


def test_a_sound_pad_is_never_mentioned(caplog: pytest.LogCaptureFixture) -> None:
    assert told(pad(60, ()), caplog) == []
