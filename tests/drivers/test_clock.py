"""Frames are dated evenly and lose nothing over restarts; those with a damaged clock are refused."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.wire import assert_are, packet, packets

from touchd.drivers.frame import CLOCK_MODULUS, Frame, ProtocolCounts
from touchd.drivers.pace import clock_ms, pace_of
from touchd.drivers.pad.clock import ArrivalClock, PadClock

STILL = np.zeros((8, 8), np.uint16)


@pytest.mark.parametrize("first_ms", [5000, 2**32 - 30], ids=["", "over the wrap after 49 days"])
@pytest.mark.parametrize(("step_ms", "is_late"), [(1, False), (250, False), (251, True)])
def test_a_frame_is_on_time_for_a_quarter_second(step_ms: int, is_late: bool, first_ms: int) -> None:
    times_ms = [first_ms, first_ms + 19, first_ms + 19 + step_ms]
    data = b"".join(encode_fabric_grid(STILL, ms % 2**32) for ms in times_ms)
    # The cells may continue a run of FF bytes in the clock, which looks like a header.
    frames = FabricGrid().feed(data + bytes(300), 0.0)
    assert len(frames) == (2 if is_late else 3)


@pytest.mark.parametrize(
    ("sent", "delivered", "counts"),
    [
        ([0, 1, 900, 2, 3], range(4), (1, 0)),
        ([0, 0, 1, 1, 1, 2], range(3), (0, 3)),
        ([0, 1, 2, 3, 2, 3, 4, 5], range(6), (1, 1)),
        ([0, 1, 3, 2, 4, 5], [0, 1, 3, 4, 5], (1, 0)),
        (range(0, 100_000, 1000), [], (99, 0)),
        ([7] * 50, [], (0, 49)),
        ([0, 1, 900, 2, 3, 901], range(4), (1, 0)),
    ],
)
def test_a_frame_with_a_wrong_clock_is_refused_and_counted(
    sent: Sequence[int], delivered: Sequence[int], counts: tuple[int, int]
) -> None:
    parser = FabricGrid()
    assert_are(parser.feed(packets(sent), 0.0), delivered)
    assert (parser.counts.bad_time, parser.counts.duplicates) == counts
    assert parser.counts.bad == counts[0]


@pytest.mark.parametrize("stamp", [float("nan"), float("inf"), -float("inf")])
def test_a_clock_that_is_not_finite_is_refused(stamp: float) -> None:
    clock = PadClock(counts := ProtocolCounts(), "ms")
    assert clock.date(stamp, 1.0, STILL) == []
    assert counts.bad_time == 1


def test_a_reset_forgets_half_a_frame_and_the_clock() -> None:
    parser = FabricGrid()
    parser.feed(packets([0, 1, 900]) + packet(2)[:50], 0.0)
    parser.reset()
    assert_are(parser.feed(packets([0, 1], 0), 0.0), [0, 1], 0)
    assert parser.counts.bad_time == 1


def arrivals_of(rate_hz: float, seconds: float, late_s: float = 0.0, seed: int = 0) -> list[float]:
    count = round(rate_hz * seconds)
    late = np.random.default_rng(seed).uniform(0, late_s, count)
    return [100.0 + number / rate_hz + late[number] for number in range(count)]


@pytest.mark.parametrize("rate_hz", [8.0, 12.0, 25.0, 50.0, 54.0, 57.0, 200.0, 500.0])
def test_frames_without_a_clock_are_dated_evenly_at_any_rate(rate_hz: float) -> None:
    clock = ArrivalClock()
    # A USB adapter holds frames back by up to 16 ms.
    stamps = [clock.stamp_ms(arrival_s) for arrival_s in arrivals_of(rate_hz, max(8.0, 200 / rate_hz), 0.016)]
    steps = np.diff(stamps)
    assert steps.min() >= 0
    later = steps[108:]
    assert later.mean() == pytest.approx(1000 / rate_hz, abs=0.1)
    assert later.std() < 2.0
    # From the second frame on there is no gap in which a touch would end.
    assert steps.max() <= 1000 / rate_hz + 20


def test_a_changed_rate_is_followed_within_two_seconds() -> None:
    clock = ArrivalClock()
    slow = [10 + number / 30 for number in range(90)]
    arrivals_s = [*slow, *(slow[-1] + number / 90 for number in range(1, 271))]
    off_ms = [clock.stamp_ms(each) - 1000 * each for each in arrivals_s]
    assert max(map(abs, off_ms[-90:])) <= 1.0
    assert max(map(abs, off_ms)) < 250


@pytest.mark.parametrize("held_s", [0.1, 0.24, 1.0, 30.0])
def test_after_a_delay_frames_are_soon_dated_by_arrival(held_s: float) -> None:
    clock = ArrivalClock()
    sent_s = arrivals_of(54, 12.0)
    arrivals_s = [max(each, 104.0 + held_s) if each >= 104.0 else each for each in sent_s]
    stamps = [clock.stamp_ms(each) for each in arrivals_s]
    assert np.diff(stamps).min() >= 0
    since = [
        stamp - 1000 * each for stamp, each in zip(stamps, arrivals_s, strict=True) if each > 106 + held_s
    ]
    assert not since or max(map(abs, since)) <= 2.0


def dated(
    stamp: Callable[[float], float],
    seconds: float = 6.0,
    arrival: Callable[[float], float] = float,
    unit: str = "ms",
) -> tuple[ProtocolCounts, list[Frame]]:
    """Feed a clock with frames at 54 Hz; return its counts and the frames.

    Both functions take the pad's time in seconds. stamp: the clock that it sends. arrival: when it arrives.
    """
    clock = PadClock(counts := ProtocolCounts(), unit)
    frames: list[Frame] = []
    for number in range(round(54 * seconds)):
        frames += clock.date(stamp(number / 54), 100.0 + arrival(number / 54), STILL)
        counts.frames = len(frames)
    return counts, frames


@pytest.mark.parametrize(
    ("unit", "stamp"),
    [
        ("ms", lambda second: round(1000 * second)),
        ("us", lambda second: round(1e6 * second) + 7),
        ("s", lambda second: 12 + second),
        ("ms", lambda second: 1_790_000_000_000 + round(1000 * second)),
        ("none", lambda second: 15.0),
    ],
    ids=["ms", "us", "s", "since 1970", "none"],
)
def test_a_clock_is_used_in_its_unit(unit: str, stamp: Callable[[float], float]) -> None:
    counts, frames = dated(stamp, unit=unit)
    assert len(frames) == 54 * 6
    assert counts.bad == 0
    steps_ms = np.diff([frame.sensor_ms for frame in frames])
    assert (steps_ms.min(), steps_ms.max()) == (18, 19)
    assert max(frame.sensor_ms for frame in frames) < 2**32


@pytest.mark.parametrize(
    ("unit", "period_s"),
    [("ms", 3.0), ("us", 3.0), ("s", 3.0), ("ms", 0.7), ("ms", 20.0)],
    ids=["ms", "microseconds", "seconds", "often", "rarely"],
)
def test_a_restarted_clock_continues_by_arrival(unit: str, period_s: float) -> None:
    counts_a_second = {"ms": 1000, "us": 1e6, "s": 1}[unit]
    counts, frames = dated(lambda second: counts_a_second * (0.007 + second % period_s), 60.0, unit=unit)
    assert len(frames) >= 54 * 60 - 1
    steps_ms = np.diff([frame.sensor_ms for frame in frames])
    assert (steps_ms.min(), steps_ms.max()) == (pytest.approx(18, abs=2), pytest.approx(19, abs=2))
    assert counts.restarts == pytest.approx(60 / period_s - 1, abs=2)


@pytest.mark.parametrize("pause_s", [0.8, 5.0])
def test_a_pause_while_the_board_starts_keeps_its_length(pause_s: float) -> None:
    _, frames = dated(
        lambda second: round(1000 * (second % 3)), 9.0, lambda second: second + second // 3 * pause_s
    )
    steps_ms = np.diff([frame.sensor_ms for frame in frames])
    assert sorted(steps_ms)[-2:] == [pytest.approx(1000 * pause_s + 19, abs=2)] * 2


def test_frames_around_a_restart_that_were_read_together_rise() -> None:
    _, frames = dated(lambda second: round(1000 * (second % 3)), 9.0, lambda second: second // 0.4 * 0.4)
    assert len(frames) == 54 * 9
    assert np.diff([frame.sensor_ms for frame in frames]).min() >= 1


@pytest.mark.parametrize(("restart_s", "is_restart"), [(0.2, False), (0.3, True)])
def test_a_clock_that_just_began_has_not_restarted(restart_s: float, is_restart: bool) -> None:
    counts, _ = dated(lambda second: round(1000 * second - 20_000 * (second >= restart_s)) + 30_000)
    assert counts.restarts == is_restart


STEP_MS = 19


def frames_at(stamps: Sequence[int]) -> list[Frame]:
    return [Frame(ms % CLOCK_MODULUS, 0.0, STILL) for ms in stamps]


def test_frames_lost_in_a_gap_are_counted() -> None:
    pace = pace_of(frames_at([5000 + STEP_MS * number for number in range(20) if number not in (8, 9, 10)]))
    assert pace.lost == 3
    assert pace.rate_hz == pytest.approx(1000 / STEP_MS)
    assert pace.jitter_ms == 0.0


@pytest.mark.parametrize("stamps", [[0] * 9, [0, 0, 0, 1] * 20, [0] * 49 + [1000], [20, 4, 12, 8, 56]])
def test_frames_in_bursts_are_not_taken_for_lost(stamps: list[int]) -> None:
    pace = pace_of(frames_at(np.cumsum(stamps * 4).tolist()))
    assert pace.lost == 0
    assert pace.rate_hz == pytest.approx(1000 / max(np.mean(stamps), 0.001), rel=0.1)


def test_a_clock_that_wraps_continues() -> None:
    stamps = [CLOCK_MODULUS - 100 + STEP_MS * number for number in range(20)]
    assert clock_ms(frames_at(stamps)).tolist() == stamps
    assert pace_of(frames_at(stamps)).lost == 0


def test_a_restarted_clock_continues_where_it_was() -> None:
    stamps = [5000 + STEP_MS * number for number in range(10)]
    frames = frames_at([*stamps, *range(0, 10 * STEP_MS, STEP_MS)])
    assert clock_ms(frames).tolist() == [*stamps, *(stamps[-1] + STEP_MS * number for number in range(10))]
