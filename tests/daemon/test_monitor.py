"""Faults of a pad's frames and values become one state and a few log lines."""

import logging
import signal
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigs.formats import FabricGrid
from rigs.haart_folder import needs_haart, recordings_of
from rigs.made_pad import MadePad, nothing
from rigs.running_daemon import Daemon
from rigs.wait import once_in_three

from touchd.daemon.app.config import SensorSettings
from touchd.daemon.path.events import SensorEvent
from touchd.daemon.path.monitor import PadMonitor
from touchd.daemon.playback.rig import encoder_for
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import CLOCK_MODULUS, Counts, Frame, SensorState
from touchd.drivers.pad.grid import MAX_GAP_MS
from touchd.drivers.recording import Stream, ideal_clock_ms, read_recordings, realign, splice

RATE_HZ = 54
STILL = np.zeros((8, 8), np.uint16)
CALM, NOISY = np.full(64, 0.8, np.float32), np.full(64, 1.5, np.float32)
DEAD_ROW = "row 7 of the 8x8 grid stands still: a broken wire?"


def sound_pad(seconds: int) -> Counts:
    return MadePad(5).counts(nothing(seconds))


def reports_of(
    counts: Counts, clock_ms: Iterable[int] | None = None, untouched: Callable[[float], bool] = lambda _: True
) -> tuple[list[tuple[float, str]], list[SensorState]]:
    """Feed a monitor; return each log line with its second, and the changes of the pad's state."""
    clock_ms = ideal_clock_ms(len(counts)).tolist() if clock_ms is None else clock_ms
    monitor, lines, states = PadMonitor(), list[tuple[float, str]](), list[SensorState]()
    handler = logging.Handler()
    now_s = 0.0
    handler.emit = lambda record: lines.append((now_s, record.getMessage()))  # type: ignore[method-assign]
    log = logging.getLogger("touchd.daemon.path.monitor")
    log.setLevel(logging.INFO)
    log.addHandler(handler)
    try:
        for ms, pressure in zip(clock_ms, counts, strict=True):
            now_s = ms / 1000
            frame = Frame(ms % CLOCK_MODULUS, now_s, pressure)
            state = monitor.on_frame(frame, restarted=False, is_untouched=untouched(now_s))
            states += [state] if state else []
    finally:
        log.removeHandler(handler)
    return lines, states


def broken(where: Any, stuck_at: Any, *spans: tuple[int, int], seconds: int = 40) -> Counts:
    """A pad with noise, a part of which stands still in each of these spans of seconds."""
    counts = sound_pad(seconds)
    for begin_s, end_s in spans:
        counts[begin_s * RATE_HZ : end_s * RATE_HZ][where] = stuck_at
    return counts


ROW_7 = np.s_[:, 6]
MANY = np.s_[:, [0, 2, 3, 5, 7], [1, 1, 6, 5, 0]]


@pytest.mark.parametrize(
    ("where", "stuck_at", "what", "degrades"),
    [
        (np.s_[:, 2, 4], 300, "the taxel at row 3 column 5 of the 8x8 grid stands still", False),
        (ROW_7, 0, DEAD_ROW, False),
        (np.s_[:, :, 0], 0, "column 1 of the 8x8 grid stands still: a broken wire?", False),
        (np.s_[:], sound_pad(1)[0], "frames arrive but no value changes: the pad is off its board", True),
        (
            MANY,
            0,
            "the taxel at row 1 column 2, row 3 column 2, row 4 column 7, row 6 column 6 and 1 more of the",
            False,
        ),
    ],
    ids=["taxel", "row", "column", "frozen", "several"],
)
def test_a_broken_pad_and_its_repair_are_reported_once(
    where: Any, stuck_at: Any, what: str, degrades: bool
) -> None:
    ((begun_s, begin), (ended_s, end)), states = reports_of(broken(where, stuck_at, (5, 20)))
    assert begin.startswith(what)
    assert end.startswith(f"no longer: {begin} (after ")
    assert 5 < begun_s < 18
    assert 20 < ended_s < 27
    told = [(state.state, state.cause) for state in states]
    assert told == ([("degraded", "frozen"), ("up", "")] if degrades else [])


def silent(*spans: tuple[int, int]) -> Counts:
    """A pad that reads 0 but for these spans of seconds, under a whole hand."""
    counts = np.zeros((60 * RATE_HZ, 8, 8), np.uint16)
    for begin_s, end_s in spans:
        counts[begin_s * RATE_HZ : end_s * RATE_HZ] = 200 + sound_pad(end_s - begin_s)
    return counts


def quiet(noise_counts: float) -> Counts:
    rng = np.random.default_rng(3)
    level = rng.uniform(10, 20, (8, 8)) + noise_counts * rng.standard_normal((120 * RATE_HZ, 8, 8))
    return np.rint(level).astype(np.uint16)


def pressed_firmly() -> Counts:
    counts = sound_pad(20)
    counts[5 * RATE_HZ : 15 * RATE_HZ, 1:5, 1:5] += 600
    return counts


def twitching() -> Counts:
    """A stuck taxel that changes in every other second."""
    counts = sound_pad(60)
    for second in range(5, 60, 2):
        counts[second * RATE_HZ : (second + 1) * RATE_HZ, 2, 4] = 300
    return counts


@pytest.mark.parametrize(
    "counts",
    [pressed_firmly(), silent(), silent((10, 20)), quiet(0.1), quiet(0.3), twitching()],
    ids=["heavy hand", "silent", "rubbed", "0.1", "0.3", "bad contact"],
)
def test_what_a_sound_pad_reads_is_not_a_fault(counts: Counts) -> None:
    assert reports_of(counts) == ([], [])


def test_a_wrapping_and_restarting_clock_does_no_harm() -> None:
    clock_ms = [*ideal_clock_ms(540, 2**32 - 3000).tolist(), *ideal_clock_ms(540).tolist()]
    assert reports_of(sound_pad(20), clock_ms) == ([], [])


def test_a_hand_does_not_show_which_taxels_stand_still() -> None:
    counts = np.zeros((20 * RATE_HZ, 8, 8), np.uint16)
    counts[: 5 * RATE_HZ] = sound_pad(5)
    assert reports_of(counts, untouched=lambda second: second >= 5) == ([], [])


def test_a_slow_pads_broken_row_is_found_between_touches() -> None:
    counts = broken(ROW_7, 0, (10, 40))
    # Ten frames a second; a hand and what it leaves take four of every six seconds.
    clock_ms = [100 * number for number in range(len(counts))]
    lines, _ = reports_of(counts, clock_ms, lambda second: second % 6 < 2)
    assert [line for _, line in lines] == [DEAD_ROW]
    assert lines[0][0] > 54


@needs_haart
def test_ten_minutes_of_real_touches_have_no_finding(tmp_path: Path) -> None:
    path = recordings_of("testWITHLABELS.csv", "T9,", tmp_path)
    counts = splice([realign(recording) for recording in read_recordings(path)]).counts
    assert len(counts) > 10 * 60 * RATE_HZ
    assert reports_of(counts) == ([], [])


def states_of(monitor: PadMonitor, times_ms: Iterable[int], at_s: float = 0.0) -> list[SensorState]:
    """Return how the pad's state changes while frames arrive at these times of its clock."""
    states, last_ms = list[SensorState | None](), -1000
    for ms in times_ms:
        frame = Frame(ms % CLOCK_MODULUS, at_s + ms / 1000, STILL)
        states.append(monitor.on_frame(frame, restarted=not 0 < ms - last_ms <= MAX_GAP_MS))
        last_ms = ms
    return [state for state in states if state is not None]


GAPS = "no touch is recognised: frames come with gaps; are they lost on the way, or do two boards send there"


@pytest.mark.parametrize(
    ("times_ms", "reason"),
    [
        ([round(1000 / 54 * i) for i in range(1200) if i % 30 < 20], GAPS),
        ([ms + 700_000 * (number % 2) for number, ms in enumerate(range(0, 9000, 18))], GAPS),
        (range(0, 15_000, 250), "no touch is recognised: 4.0 frames a second come, and 8 or more are needed"),
        (range(0, 15_000, 160), "no touch is recognised: 6.2 frames a second come, and 8 or more are needed"),
        (range(0, 15_000, 125), ""),
        ([*range(0, 5500, 18), *range(6000, 11_500, 18), *range(12_000, 17_500, 18)], ""),
        ([ms for ms in range(0, 20_000, 100) if ms % 2500 > 200], ""),
    ],
    ids=["runs are lost", "two boards", "4 Hz", "6 Hz", "8 Hz", "single gaps", "single gaps at 10 Hz"],
)
def test_gaps_and_a_low_rate_degrade_the_pad(times_ms: Iterable[int], reason: str) -> None:
    monitor = PadMonitor()
    told = states_of(monitor, times_ms)
    assert [(state.state, state.cause) for state in told] == ([("degraded", "gaps")] if reason else [])
    assert all(state.reason.startswith(reason) for state in told)
    if reason:
        assert [state.state for state in states_of(monitor, range(30_000, 40_000, 18))] == ["up"]


def test_stale_frames_after_a_pause_are_not_judged() -> None:
    monitor = PadMonitor()
    assert states_of(monitor, range(0, 5000, 18)) == []
    # Ten frames waited in the port's buffer; those after them were lost.
    assert states_of(monitor, range(5000, 5180, 18), at_s=20.0) == []
    assert states_of(monitor, range(25_300, 30_000, 18)) == []


@once_in_three
def test_a_daemon_that_was_stopped_blames_neither_pad_nor_clock(tmp_path: Path) -> None:
    counts = sound_pad(60)
    stream = Stream(counts, ideal_clock_ms(len(counts)), ())
    with FakePort(stream, encoder_for(SensorSettings())) as pad, Daemon(tmp_path, pad) as daemon:
        daemon.await_event(SensorEvent)
        daemon.process.send_signal(signal.SIGSTOP)
        # Longer than a pad may be silent.
        time.sleep(2.5)
        daemon.process.send_signal(signal.SIGCONT)
        time.sleep(0.3)
        assert daemon.stop() == 0
    assert [event.state for event in daemon.events if isinstance(event, SensorEvent)] == ["up"]
    assert [line for line in daemon.log.splitlines() if "drivers.pad" in line and "WARNING" in line] == []


@pytest.mark.parametrize(("every_s", "is_often"), [(29.0, True), (31.0, False)])
def test_a_pad_that_restarts_often_is_degraded_until_steady(every_s: float, is_often: bool) -> None:
    parser, told = FabricGrid(), list[tuple[str, str]]()
    monitor = PadMonitor(parser=parser)
    for tenth in range(1300):
        if tenth in (10, 10 + 10 * every_s, 10 + 20 * every_s):
            parser.counts.restarts += 1
        if state := monitor.on_frame(Frame(100 * tenth, tenth / 10, STILL), restarted=False):
            told.append((state.state, state.cause))
        # It is steady a minute after its last restart.
        if tenth < 10 * (1 + 2 * every_s + 60):
            assert ("up", "") not in told
    assert told == ([("degraded", "restarts"), ("up", "")] if is_often else [])


def test_a_noisy_pad_is_degraded_after_five_seconds_until_calm() -> None:
    monitor, seconds = PadMonitor(), list[float]()
    for number in range(20 * RATE_HZ):
        # For a second in between, as a hand leaves it.
        is_noisy = number < 10 * RATE_HZ and not RATE_HZ < number < 2 * RATE_HZ
        monitor.on_rest(NOISY if is_noisy else CALM)
        frame = Frame(round(1000 * number / RATE_HZ), number / RATE_HZ, STILL)
        if monitor.on_frame(frame, restarted=False) is not None:
            seconds.append(number / RATE_HZ)
    begun_s, ended_s = seconds
    assert 6.4 < begun_s < 8.0
    assert 14.4 < ended_s < 16.0


def noisy_for(monitor: PadMonitor, seconds: int) -> list[SensorState]:
    states = list[SensorState]()
    for ms in range(0, 1000 * seconds, 18):
        monitor.on_rest(NOISY)
        state = monitor.on_frame(Frame(ms, ms / 1000, STILL), restarted=False)
        states += [state] if state else []
    return states


def test_a_returned_pad_is_not_noisy_until_measured_again(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    monitor = PadMonitor()
    assert [now.cause for now in noisy_for(monitor, 8)] == ["noise"]
    monitor.on_sensor(SensorState("down", "unplugged"))
    monitor.on_sensor(SensorState("up", ""))
    assert states_of(monitor, range(20_000, 30_000, 18)) == []
    assert "no longer" not in caplog.text


def test_a_graver_cause_of_a_degraded_pad_is_reported() -> None:
    monitor = PadMonitor()
    states = noisy_for(monitor, 8) + states_of(monitor, range(10_000, 25_000, 250))
    assert [state.cause for state in states] == ["noise", "gaps"]
