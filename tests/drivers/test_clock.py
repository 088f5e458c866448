"""Clock checks: no frame is lost after a restart, and frames with a damaged clock are refused."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.wire import assert_are, counts_of, flip, packet, packets

from touchd.drivers.pad.clock import MAX_HELD, ArrivalClock, FrameClock
from touchd.drivers.pad.protocol_counts import ProtocolCounts

STILL = np.zeros((8, 8), np.uint16)


@pytest.mark.parametrize("restart_ms", [0, 3, 1_000_000])
def test_after_a_reboot_no_frame_is_lost(restart_ms: int) -> None:
    parser = FabricGrid()
    before = parser.feed(packets(range(3)), 0.0)
    after = [frame for number in range(4) for frame in parser.feed(packet(number, restart_ms), float(number))]
    assert_are(before, range(3))
    assert_are(after, range(4), restart_ms)
    assert [frame.host_s for frame in after] == [0.0, 1.0, 2.0, 3.0]
    assert parser.counts.bad == 0


def test_a_reboot_amid_garbage_loses_no_intact_frame() -> None:
    parser = FabricGrid()
    wrong_clock = encode_fabric_grid(counts_of(9), 123_456_789)
    rebooted = (
        packet(0, 0) + b"ets Jun  8 2016\r\n" + wrong_clock + flip(packet(1, 0), 70) + packets([2, 3], 0)
    )
    frames = parser.feed(packets(range(3)) + rebooted, 0.0)
    assert_are(frames[:3], range(3))
    assert_are(frames[3:], [0, 2, 3], 0)
    assert (parser.counts.bad_time, parser.counts.bad_checksum, parser.counts.bad_framing) == (1, 1, 1)


@pytest.mark.parametrize("first_ms", [5000, 2**32 - 30], ids=["", "over the wrap after 49 days"])
@pytest.mark.parametrize(("step_ms", "is_late"), [(1, False), (250, False), (251, True)])
def test_a_frame_is_on_time_for_a_quarter_second(step_ms: int, is_late: bool, first_ms: int) -> None:
    times_ms = [first_ms, first_ms + 19, first_ms + 19 + step_ms]
    data = b"".join(encode_fabric_grid(STILL, ms % 2**32) for ms in times_ms)
    frames = FabricGrid().feed(data, 0.0)
    assert len(frames) == (2 if is_late else 3)


@pytest.mark.parametrize(
    ("sent", "delivered", "counts"),
    [
        ([0, 1, 900, 2, 3], range(4), (1, 0)),
        ([0, 0, 1, 1, 1, 2], range(3), (0, 3)),
        ([0, 1, 2, 3, 2, 3, 4, 5], range(6), (1, 1)),
        (range(0, 100_000, 1000), [], (100 - MAX_HELD, 0)),
    ],
    ids=["wild clock", "frames sent twice", "frames replayed", "random clock"],
)
def test_a_frame_with_a_wrong_clock_is_refused_and_counted(
    sent: Sequence[int], delivered: Sequence[int], counts: tuple[int, int]
) -> None:
    parser = FabricGrid()
    assert_are(parser.feed(packets(sent), 0.0), delivered)
    assert (parser.counts.bad_time, parser.counts.duplicates) == counts
    assert parser.counts.bad == counts[0]


def test_a_reset_forgets_half_a_frame_and_the_clock() -> None:
    parser = FabricGrid()
    parser.feed(packets([0, 1]) + packet(2)[:50], 0.0)
    parser.reset()
    frames = parser.feed(packets([0, 1], 0), 0.0)
    assert_are(frames, [0, 1], 0)
    assert parser.counts.bytes_dropped == 50


def test_after_many_wrong_clocks_a_reboot_loses_no_frame() -> None:
    parser = FabricGrid()
    wild = b"".join(packet(0, 10_000_000 * number) for number in range(1, 2 * MAX_HELD))
    frames = parser.feed(packets(range(3)) + wild + packets(range(3), 85_000_000), 0.0)
    assert_are(frames[:3], range(3))
    assert_are(frames[3:], range(3), 85_000_000)
    assert parser.counts.bad_time == parser.counts.bad == 2 * MAX_HELD - 1


@pytest.mark.parametrize("is_reset", [True, False])
def test_a_frame_that_continues_a_refused_clock_is_refused(is_reset: bool) -> None:
    parser = FabricGrid()
    parser.feed(packets([0, 1, 900]), 0.0)
    if is_reset:
        parser.reset()
    else:
        assert_are(parser.feed(packets([50, 51]), 1.0), [50, 51])
    assert parser.counts.bad_time == 1
    assert parser.feed(packets([901]), 2.0) == []


def test_arrival_stamps_rise_even_in_a_burst() -> None:
    clock = ArrivalClock(54.0)
    stamps = [clock.stamp_ms(1.0) for _ in range(40)]
    assert all(earlier < later for earlier, later in pairwise(stamps))


@pytest.mark.parametrize("rate_hz", [15.0, 51.3, 200.0])
def test_a_pad_off_its_stated_rate_is_followed(rate_hz: float) -> None:
    clock = ArrivalClock(54.0)
    arrivals_s = [100.0 + number / rate_hz for number in range(round(20 * rate_hz))]
    off_ms = [clock.stamp_ms(arrival_s) - 1000.0 * arrival_s for arrival_s in arrivals_s]
    assert max(map(abs, off_ms[-108:])) <= 1.0


@pytest.mark.parametrize("rate_hz", [8.0, 10.0, 12.0])
def test_a_slow_pad_without_a_clock_has_no_gap_after_a_second(rate_hz: float) -> None:
    clock, late_s = ArrivalClock(54.0), np.random.default_rng(0).uniform(0, 0.016, 100)
    stamps = [clock.stamp_ms(100.0 + number / rate_hz + late_s[number]) for number in range(100)]
    assert np.diff(stamps)[8:].max() <= 1000 / rate_hz + 20


@pytest.mark.parametrize("rate_hz", [50.0, 54.0])
def test_frames_that_come_unevenly_are_dated_evenly_from_the_start(rate_hz: float) -> None:
    clock, late_s = ArrivalClock(54.0), np.random.default_rng(0).uniform(0, 0.016, 540)
    stamps = [clock.stamp_ms(100.0 + number / rate_hz + late_s[number]) for number in range(540)]
    assert abs(np.diff(stamps) - 1000 / rate_hz).max() <= 5


def test_after_a_flood_the_arrival_clock_is_not_ahead() -> None:
    clock = ArrivalClock(54.0)
    for number in range(50_000):
        clock.stamp_ms(number / 10_000)
    after = [clock.stamp_ms(5.0 + number / 54) - 5000.0 - 1000 * number / 54 for number in range(108)]
    assert max(map(abs, after[81:])) <= 20.0


def test_a_gap_restarts_the_arrival_clock() -> None:
    clock = ArrivalClock(54.0)
    before = [clock.stamp_ms(number / 54) for number in range(54)]
    assert before[-1] == round(1000 * 53 / 54)
    assert clock.stamp_ms(1.3) == 1300


def dated(
    stamp: Callable[[float], float],
    seconds: float = 6.0,
    arrival: Callable[[float], float] = float,
    stated_hz: float = 54.0,
) -> tuple[FrameClock, list[tuple[float, int]]]:
    """Feed a clock with frames at 54 Hz; return it, and each frame's arrival in s and time in ms.

    Both functions take the pad's time in seconds. stamp: the clock value it sends. arrival: when it arrives.
    """
    clock = FrameClock(ProtocolCounts(), stated_hz)
    frames: list[tuple[float, int]] = []
    for number in range(round(54 * seconds)):
        host_s = 100.0 + arrival(number / 54)
        readings = clock.judge(stamp(number / 54), host_s, STILL)
        frames += [(reading.host_s, reading.sensor_ms) for reading in readings]
        clock.counts.frames = len(frames)
    return clock, frames


def is_in_ms(frames: list[tuple[float, int]]) -> bool:
    """Whether the frames' times over the last three seconds advance in ms as their arrivals do."""
    (first_s, first_ms), *_, (last_s, last_ms) = frames[-162:]
    return abs((last_ms - first_ms) / 1000 - (last_s - first_s)) < 0.03


@pytest.mark.parametrize(
    "counts_a_second",
    [1000.0, 840.0, 1160.0, 1e6, 1.0],
    ids=["ms", "slow", "fast", "microseconds", "seconds"],
)
def test_a_clock_is_used_in_the_unit_that_it_counts(counts_a_second: float) -> None:
    clock, frames = dated(lambda second: 7.0 + second * counts_a_second)
    assert clock.note == ""
    steps_ms = np.diff([ms for _, ms in frames[-200:]])
    unit_ms = 1000 / 10 ** round(np.log10(counts_a_second))
    assert steps_ms.mean() == pytest.approx(counts_a_second * unit_ms / 54, rel=5e-4)


def test_a_clock_of_epoch_milliseconds_is_kept_to_32_bits() -> None:
    clock, frames = dated(lambda second: 1_790_000_000_000 + round(1000 * second))
    assert clock.dates_frames
    assert is_in_ms(frames)
    assert max(ms for _, ms in frames) < 2**32


def test_after_a_reset_another_clocks_unit_is_found_within_two_seconds() -> None:
    clock, _ = dated(lambda second: 1000 * second)
    clock.reset()
    assert not clock.dates_frames
    for number in range(108):
        clock.judge(1e6 * number / 54, 200.0 + number / 54, STILL)
    assert clock.dates_frames


@pytest.mark.parametrize(
    ("stamp", "why"),
    [
        (lambda second: 500 * second, "counts 500 in a second"),
        (lambda second: 2000 * second, "counts 2000 in a second"),
        (lambda second: 10_000 * second, "counts 10000 in a second"),
        (lambda second: 3.0, "stands still or jumps"),
        (lambda second: float(int(second)), "stands still or jumps"),
        (lambda second: 23.0 + 0.4 * np.sin(40 * second), "stands still or jumps"),
        (lambda second: -1000 * second, "stands still or jumps"),
    ],
    ids=["half", "twice", "tenths", "constant", "whole seconds", "temperature", "backwards"],
)
def test_a_number_that_is_not_a_clock_is_skipped(stamp: Callable[[float], float], why: str) -> None:
    clock, frames = dated(stamp)
    assert why in clock.note
    assert clock.note.endswith("it is not used, and frames are dated by their arrival")
    assert is_in_ms(frames)
    assert len(frames) >= 54 * 4


@pytest.mark.parametrize("rate_hz", [5.0, 15.0, 54.0])
def test_a_constant_number_delays_no_frame_beyond_a_second(rate_hz: float) -> None:
    clock = FrameClock(ProtocolCounts(), rate_hz)
    delivered_s = [
        reading.host_s for number in range(60) for reading in clock.judge(15.0, number / rate_hz, STILL)
    ]
    assert delivered_s[0] <= 1.0
    assert "stands still" in clock.note


def test_frames_sent_twice_keep_their_clock_from_the_start() -> None:
    clock, frames = dated(lambda second: 1000 * (int(54 * second) // 2) // 54)
    assert clock.note == ""
    assert len(frames) == pytest.approx(27 * 6, abs=2)


def test_a_frame_number_is_neither_a_clock_nor_a_fault() -> None:
    clock, frames = dated(lambda second: round(54 * second))
    assert clock.note == ""
    assert is_in_ms(frames)
    assert len(frames) >= 54 * 4


@pytest.mark.parametrize("speed", [0.5, 2.0, 16.0, 100.0])
def test_a_recording_played_faster_keeps_its_clock(speed: float) -> None:
    clock, frames = dated(lambda second: round(1000 * second), 6 * speed, lambda second: second / speed)
    assert clock.note == ""
    assert len(frames) == round(54 * 6 * speed)
    assert np.diff([ms for _, ms in frames]).mean() == pytest.approx(1000 / 54, rel=0.01)


def test_frames_that_were_held_up_do_not_discredit_a_clock() -> None:
    # In every five seconds the line delivers nothing for three, then everything at once.
    clock, frames = dated(
        lambda second: round(1000 * second),
        60.0,
        lambda second: second if second % 5 < 2 else second // 5 * 5 + 5,
    )
    assert clock.note == ""
    assert len(frames) == 54 * 60


def slow_for_two_thirds(second: float) -> float:
    """Half a second of arrival at 1.5 times the pad's rate, then a second at three quarters of it."""
    turns, rest = divmod(second, 1.51)
    return 1.5 * turns + (0.65 * rest if rest < 0.769 else 0.5 + 1.35 * (rest - 0.769))


@pytest.mark.parametrize(
    "arrival",
    [lambda second: second / 2 if second < 1.2 else second - 0.6, slow_for_two_thirds],
    ids=["frames that waited come first", "the line slows down and catches up"],
)
def test_an_uneven_arrival_does_not_discredit_a_clock(arrival: Callable[[float], float]) -> None:
    for stated_hz in (54.0, 100.0):
        clock, frames = dated(lambda second: round(1000 * second), arrival=arrival, stated_hz=stated_hz)
        assert clock.note == ""
        assert np.diff([ms for _, ms in frames]).max() <= 19


@pytest.mark.parametrize("stamp", [math.nan, math.inf])
def test_a_frame_whose_clock_is_no_number_is_dated_by_arrival(stamp: float) -> None:
    clock, _ = dated(lambda second: 1000 * second)
    (reading,) = clock.judge(stamp, 120.0, STILL)
    assert reading.sensor_ms == 120_000


def test_any_frame_is_on_time_for_a_number_that_is_not_a_clock() -> None:
    clock, _ = dated(float)
    assert clock.is_on_time(6.01)
    assert not clock.is_on_time(100.0)
    skipped, _ = dated(lambda second: 500 * second)
    assert skipped.is_on_time(100.0)


def test_a_daemon_stopped_for_long_does_not_discredit_a_clock() -> None:
    clock = FrameClock(ProtocolCounts(), 54.0)
    # Five seconds of frames wait in the port's buffer; fifteen are lost.
    for begin_s, end_s, late_s in ((0, 10, 0.0), (10, 15, 20.0), (30, 60, 0.0)):
        for number in range(54 * begin_s, 54 * end_s):
            arrival_s = begin_s + late_s if late_s else number / 54
            clock.judge(round(1000 * number / 54), arrival_s, STILL)
            assert clock.note == ""


@pytest.mark.parametrize(
    ("unit", "period_s"),
    [(1.0, 3.0), (1000.0, 3.0), (0.001, 3.0), (1.0, 0.7), (1.0, 20.0)],
    ids=["ms", "microseconds", "seconds", "often", "rarely"],
)
def test_a_clock_that_restarts_is_dated_on_by_arrival(unit: float, period_s: float) -> None:
    clock, frames = dated(lambda second: unit * round(7 + 1000 * (second % period_s)), 60.0)
    assert clock.note == ""
    # The unit is known after a second and a half.
    assert len(frames) >= 54 * 58
    steps_ms = np.diff([ms for _, ms in frames[108:]])
    assert (steps_ms.min(), steps_ms.max()) == (pytest.approx(18, abs=2), pytest.approx(19, abs=2))
    # Restarts within a second are one.
    assert clock.counts.restarts == pytest.approx(
        60 / (period_s if period_s > 1 else 2 * period_s) - 1, abs=2
    )


@pytest.mark.parametrize("period_s", [0.05, 0.1, 0.25, 0.5])
def test_a_clock_that_begins_again_within_each_window_loses_no_frame(period_s: float) -> None:
    # After a window it may read what it read before.
    _, frames = dated(lambda second: int(1000 * second) % (1000 * period_s), 20.0)
    assert len(frames) >= 54 * 20 - 1


def test_a_clock_damaged_to_a_huge_number_ends_nothing() -> None:
    clock, _ = dated(lambda second: second)
    clock._unit_ms = 1000.0
    assert len(clock.judge(1e307, 106.0, STILL)) == 1


@pytest.mark.parametrize("pause_s", [0.8, 5.0])
def test_a_pause_while_the_board_starts_is_dated_as_long_as_it_was(pause_s: float) -> None:
    _, frames = dated(
        lambda second: round(1000 * (second % 3)), 9.0, lambda second: second + second // 3 * pause_s
    )
    steps_ms = np.diff([ms for _, ms in frames])
    assert sorted(steps_ms)[-2:] == [pytest.approx(1000 * pause_s + 19, abs=2)] * 2


def test_frames_around_a_restart_that_were_read_together_rise() -> None:
    _, frames = dated(lambda second: round(1000 * (second % 3)), 9.0, lambda second: second // 0.4 * 0.4)
    assert len(frames) == 54 * 9
    assert np.diff([ms for _, ms in frames]).min() >= 1


@pytest.mark.parametrize(
    ("jump_s", "restart_s", "is_restart"),
    [(1.0, 1.0, False), (1.0, 60.5, False), (1.0, 61.5, True), (0.0, 0.2, False), (0.0, 0.3, True)],
)
def test_a_clock_that_jumped_ahead_lately_or_just_began_has_not_restarted(
    jump_s: float, restart_s: float, is_restart: bool
) -> None:
    clock, _ = dated(
        lambda second: (
            round(1000 * second + 50_000 * (second >= jump_s > 0) - 20_000 * (second >= restart_s)) + 30_000
        ),
        restart_s + 2.0,
    )
    assert clock.counts.restarts == is_restart


@pytest.mark.parametrize("turn_s", [0.1, 0.3, 1.0, 4.0])
def test_two_boards_on_one_line_are_at_most_one_restart(turn_s: float) -> None:
    clock, _ = dated(lambda second: round(1000 * second) + 90_000 * (second % (2 * turn_s) < turn_s), 55.0)
    assert clock.counts.restarts <= 1
