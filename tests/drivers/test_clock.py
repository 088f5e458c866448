"""Clock checks: no frame is lost after a restart, and frames with a damaged clock are refused."""

from collections.abc import Sequence
from itertools import pairwise

import pytest
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.wire import assert_are, counts_of, flip, packet, packets

from touchd.drivers.pad.clock import MAX_HELD, ArrivalClock


@pytest.mark.parametrize("restart_ms", [0, 3, 1_000_000])
def test_after_a_reboot_no_frame_is_lost(restart_ms: int) -> None:
    parser = FabricGrid()
    before = parser.feed(packets(range(3)), 0.0)
    after = [frame for number in range(4) for frame in parser.feed(packet(number, restart_ms), float(number))]
    assert_are(before, range(3))
    assert_are(after, range(4), restart_ms)
    assert [frame.number for frame in after] == [3, 4, 5, 6]
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
@pytest.mark.parametrize(("lost", "is_late"), [(12, False), (13, True)])
def test_a_frame_is_on_time_for_a_quarter_second(lost: int, is_late: bool, first_ms: int) -> None:
    frames = FabricGrid().feed(packets([0, 1, 2 + lost], first_ms), 0.0)
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
    assert [frame.number for frame in frames] == [2, 3]
    assert parser.counts.bytes_dropped == 50


@pytest.mark.parametrize("is_reset", [True, False])
def test_a_frame_with_a_wrong_clock_waits_for_the_next_no_longer_than_its_run(is_reset: bool) -> None:
    parser = FabricGrid()
    parser.feed(packets([0, 1, 900]), 0.0)
    if is_reset:
        parser.reset()
    else:
        assert_are(parser.feed(packets([50, 51]), 1.0), [50, 51])
    assert parser.counts.bad_time == 1
    assert parser.feed(packets([901]), 2.0) == []


def test_stamps_of_arrival_rise_though_frames_come_at_once() -> None:
    clock = ArrivalClock(54.0)
    stamps = [clock.stamp_ms(1.0) for _ in range(40)]
    assert all(earlier < later for earlier, later in pairwise(stamps))


def test_a_pad_off_its_stated_rate_is_followed_within_seconds() -> None:
    clock, arrivals_s = ArrivalClock(54.0), [100.0 + number / 51.3 for number in range(270)]
    off_ms = [clock.stamp_ms(arrival_s) - 1000.0 * arrival_s for arrival_s in arrivals_s]
    assert max(map(abs, off_ms[108:])) <= 1.0


def test_a_flood_of_frames_does_not_leave_the_clock_of_arrivals_ahead() -> None:
    clock = ArrivalClock(54.0)
    for number in range(50_000):
        clock.stamp_ms(number / 10_000)
    after = [clock.stamp_ms(5.0 + number / 54) - 5000.0 - 1000 * number / 54 for number in range(108)]
    assert max(map(abs, after[81:])) <= 20.0


def test_a_gap_restarts_the_clock_of_arrivals() -> None:
    clock = ArrivalClock(54.0)
    before = [clock.stamp_ms(number / 54) for number in range(54)]
    assert before[-1] == round(1000 * 53 / 54)
    assert clock.stamp_ms(1.3) == 1300
