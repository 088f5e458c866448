"""A broken pad is recognised by its values; its log has one line when it begins and one when it ends."""

import logging
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigs.haart_folder import needs_haart
from rigs.made_pad import MadePad, nothing
from rigs.patient_port import playing
from rigs.running_daemon import run_daemon

from touchd.daemon.config import SensorSettings, Settings
from touchd.daemon.events import SensorEvent
from touchd.drivers.frame import Counts, Frame
from touchd.drivers.pad.health import Finding, PadHealth
from touchd.drivers.pad.watch import LASTS_S, SAME_TROUBLE_S, PadWatch
from touchd.drivers.recording import Selection, Stream, ideal_clock_ms, read_recordings, realign, splice

RATE_HZ = 54
DEAD_ROW = "row 7 of the pad stands still: a broken wire?"
# Frames, rows and columns.
A_TAXEL, ROW_7, SATURATED = np.s_[:, 2, 4], np.s_[:, 6], np.s_[:, 2:6, 2:7]


def sound_pad(seconds: int) -> Counts:
    return MadePad(5).counts(nothing(seconds))


def frames_of(counts: Counts, clock_ms: Iterable[int] | None = None) -> list[Frame]:
    clock_ms = ideal_clock_ms(len(counts)).tolist() if clock_ms is None else clock_ms
    return [Frame(0, ms, ms / 1000, pressure) for ms, pressure in zip(clock_ms, counts, strict=True)]


def findings_in(counts: Counts, clock_ms: Iterable[int] | None = None) -> list[tuple[float, Finding]]:
    """Return each finding with its second on the pad's clock."""
    health, frames = PadHealth(), frames_of(counts, clock_ms)
    return [(frame.sensor_ms / 1000, found) for frame in frames if (found := health.update(frame))]


def kinds_in(counts: Counts) -> list[tuple[str, bool]]:
    """Return what begins (True) and ends."""
    return [(found.kind, found.began) for _, found in findings_in(counts)]


def logged(counts: Counts, caplog: pytest.LogCaptureFixture) -> list[tuple[int, str, str]]:
    """Return each log line's second, level and message."""
    caplog.set_level(logging.INFO)
    watch, lines = PadWatch(), list[tuple[int, str, str]]()
    for frame in frames_of(counts):
        caplog.clear()
        watch.update(frame)
        lines += [(frame.sensor_ms // 1000, record.levelname, record.message) for record in caplog.records]
    return lines


def said(finding: str) -> list[tuple[str, str]]:
    """Return the levels and messages of a finding that begins and ends."""
    return [("WARNING", finding), ("INFO", f"no longer: {finding}")]


def pad_with_dead_row(seconds: int, *broken: tuple[int, int]) -> Counts:
    """A pad whose seventh row is dead in each of these spans of seconds."""
    counts = sound_pad(seconds)
    for begin_s, end_s in broken:
        counts[begin_s * RATE_HZ : end_s * RATE_HZ][ROW_7] = 0
    return counts


@pytest.mark.parametrize(
    ("where", "stuck_at", "kind", "what"),
    [
        (A_TAXEL, 300, "stuck taxel", "the taxel at row 3 column 5 stands still"),
        (ROW_7, 0, "dead line", "row 7 of the pad stands still: a broken wire?"),
        (np.s_[:, :, 0], 0, "dead line", "column 1 of the pad stands still: a broken wire?"),
        (np.s_[:], sound_pad(1)[0], "frozen", "frames arrive but no value changes"),
        (SATURATED, 1023, "saturated", "a quarter of the pad or more is at its limit"),
    ],
    ids=["taxel", "row", "column", "frozen", "saturated"],
)
def test_a_broken_pad_and_its_repair_are_reported_once(
    where: Any, stuck_at: Any, kind: str, what: str, caplog: pytest.LogCaptureFixture
) -> None:
    counts = sound_pad(30)
    counts[5 * RATE_HZ : 20 * RATE_HZ][where] = stuck_at
    (begun_s, begin), (ended_s, end) = findings_in(counts)
    assert (begin.kind, begin.began, end.kind, end.began) == (kind, True, kind, False)
    assert begin.what.startswith(what)
    assert 5 < begun_s < 18
    assert 20 < ended_s < 25
    assert [line[1:] for line in logged(counts, caplog)] == said(begin.what)


def test_a_heavy_still_hand_is_no_fault() -> None:
    counts = sound_pad(20)
    counts[5 * RATE_HZ : 15 * RATE_HZ, 1:5, 1:5] += 600
    assert findings_in(counts) == []


def test_a_hand_that_covers_the_pad_for_45_s_is_no_drift() -> None:
    counts = sound_pad(240)
    counts[100 * RATE_HZ : 145 * RATE_HZ] += 30
    assert findings_in(counts) == []


def test_a_load_at_the_limit_two_thirds_of_the_time_is_no_fault() -> None:
    counts = sound_pad(30)
    for first in range(0, 30 * RATE_HZ, 9):
        counts[first : first + 6][SATURATED] = 1023
    assert findings_in(counts) == []


def test_a_load_that_wavers_at_the_limit_is_one_finding() -> None:
    counts = sound_pad(40)
    counts[5 * RATE_HZ : 15 * RATE_HZ][SATURATED] = 1023
    for first in range(15 * RATE_HZ, 40 * RATE_HZ, 10):
        counts[first : first + 7][SATURATED] = 1023
    assert kinds_in(counts) == [("saturated", True)]


def test_a_firm_fingertip_at_the_limit_is_no_fault() -> None:
    counts = sound_pad(20)
    fingertip = counts[5 * RATE_HZ :, 2:5, 2:5]
    fingertip[:] = np.random.default_rng(1).integers(1000, 1024, fingertip.shape)
    assert findings_in(counts) == []


def test_a_stuck_taxel_that_twitches_now_and_then_is_one_finding() -> None:
    counts = sound_pad(90)
    counts[5 * RATE_HZ :, 3, 3] = 100
    # In a twentieth of the frames, for ten seconds at a time.
    for first in range(30 * RATE_HZ, 90 * RATE_HZ, 20 * RATE_HZ):
        counts[first : first + 10 * RATE_HZ : 40, 3, 3] = 101
    assert kinds_in(counts) == [("stuck taxel", True)]


def test_an_intermittent_contact_does_not_flood_the_log() -> None:
    counts = sound_pad(60)
    for second in range(5, 60, 2):
        counts[second * RATE_HZ : (second + 1) * RATE_HZ][A_TAXEL] = 300
    assert len(findings_in(counts)) <= 1


def test_several_broken_taxels_are_one_finding() -> None:
    counts = sound_pad(20)
    counts[:, [0, 2, 3, 5, 7], [1, 1, 6, 5, 0]] = 0
    ((_, finding),) = findings_in(counts)
    assert finding.what == (
        "the taxel at row 1 column 2, row 3 column 2, row 4 column 7, row 6 column 6 and 1 more stands still"
    )


def test_a_pad_that_is_silent_at_rest_is_not_broken() -> None:
    counts = np.zeros((60 * RATE_HZ, 8, 8), np.uint16)
    counts[20 * RATE_HZ : 25 * RATE_HZ, 2:5, 2:5] = 200 + sound_pad(5)[:, 2:5, 2:5]
    assert findings_in(counts) == []


def test_a_creeping_rest_and_its_return_are_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    counts = sound_pad(300)
    creep = np.concatenate([np.zeros(80), np.linspace(0, 40, 100), np.zeros(120)])
    counts += np.repeat(creep, RATE_HZ).astype(np.uint16)[:, None, None]
    (begun_s, begin), (ended_s, end) = findings_in(counts)
    assert (begin.kind, begin.began, end.began) == ("drift", True, False)
    assert 80 < begun_s < 180 < ended_s < 270
    assert [line[1:] for line in logged(counts, caplog)] == said(begin.what)
    assert "the level at rest rose by" in begin.what


@pytest.mark.parametrize("levels", [(0, 14, 7, 14), (14, 0, 14, 7)], ids=["wavers", "falls first"])
def test_a_rest_that_has_risen_is_one_finding_while_it_wavers(levels: tuple[int, ...]) -> None:
    counts = sound_pad(400)
    counts += np.repeat(np.array(levels, np.uint16), 100 * RATE_HZ)[:, None, None]
    assert kinds_in(counts) == [("drift", True)]


def test_a_restarting_clock_does_no_harm() -> None:
    clock_ms = [*(ideal_clock_ms(540, 2**32 - 3000) % 2**32).tolist(), *ideal_clock_ms(540).tolist()]
    assert findings_in(sound_pad(20), clock_ms) == []


def test_the_daemon_logs_a_dead_row_and_its_return_once(tmp_path: Path) -> None:
    counts = pad_with_dead_row(32, (4, 20))
    with playing(Stream(counts, ideal_clock_ms(len(counts)), ()), speed=100.0) as port:
        events, log = run_daemon(Settings(sensor=SensorSettings(port=port.path)), tmp_path, port)
    lines = [line for line in log.splitlines() if "pad.watch" in line]
    assert lines == [f"{level} touchd.drivers.pad.watch: {what}" for level, what in said(DEAD_ROW)]
    assert {type(event) for event in events} <= {SensorEvent}


def test_a_loose_wire_is_reported_once_in_ten_minutes(caplog: pytest.LogCaptureFixture) -> None:
    counts = pad_with_dead_row(300, *((begin_s, begin_s + 12) for begin_s in range(5, 280, 30)))
    assert [line[1:] for line in logged(counts, caplog)] == said(DEAD_ROW)


def test_a_wire_that_breaks_again_is_reported_again(caplog: pytest.LogCaptureFixture) -> None:
    first, again = logged(pad_with_dead_row(150, (5, 20), (40, 150)), caplog)[::2]
    assert (first[1:], again[1:]) == (("WARNING", DEAD_ROW), ("WARNING", DEAD_ROW))
    assert 40 + LASTS_S < again[0] < 40 + LASTS_S + 15 < SAME_TROUBLE_S


@needs_haart
def test_ten_minutes_of_real_touches_have_no_finding() -> None:
    path = Path(os.environ["TOUCHD_HAART"]) / "testWITHLABELS.csv.gz"
    recordings = [realign(recording) for recording in read_recordings(path, Selection(participants=("T9",)))]
    counts = splice(recordings).counts
    assert len(counts) > 10 * 60 * RATE_HZ
    assert findings_in(counts) == []
