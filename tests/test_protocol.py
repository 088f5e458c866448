"""Bytes become frames: every intact one once and in order, nothing damaged, whatever the line does."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drivers.frame import Counts, Frame
from drivers.protocol import (
    CsvLines,
    FabricGrid,
    Protocol,
    ProtocolError,
    encode_csv_line,
    encode_fabric_grid,
)

PERIOD_MS = 19
# A busy machine is no failure: examples have no deadline of their own, the test's timeout stands.
UNHURRIED = settings(deadline=None)
MANY = settings(deadline=None, max_examples=200)
SIZE = 4 + 4 + 2 * 100 + 1
HEADER_BITS = range(32)
CHECKSUM_BITS = range(SIZE * 8 - 8, SIZE * 8)
TIME_BITS = range(32, 64)
# Bits 8 and 9 of a value do not enter the checksum and leave it below 1024: no reader can see them flip.
VISIBLE_VALUE_BITS = [64 + 16 * value + bit for value in range(100) for bit in range(16) if bit not in (8, 9)]


def counts_of(number: int) -> Counts:
    return np.random.default_rng(number).integers(0, 1024, (8, 8)).astype(np.uint16)


def packet(number: int, first_ms: int = 5000) -> bytes:
    return encode_fabric_grid(counts_of(number), first_ms + number * PERIOD_MS)


def packets(numbers: Sequence[int], first_ms: int = 5000) -> bytes:
    return b"".join(packet(number, first_ms) for number in numbers)


def flip(data: bytes, bit: int) -> bytes:
    flipped = bytearray(data)
    flipped[bit // 8] ^= 1 << bit % 8
    return bytes(flipped)


def fed(parser: Protocol, data: bytes, cuts: Sequence[int] = ()) -> list[Frame]:
    edges = [0, *sorted(cuts), len(data)]
    pieces = [data[start:stop] for start, stop in pairwise(edges)]
    return [frame for piece in pieces for frame in parser.feed(piece, 1.0)]


def assert_are(frames: Sequence[Frame], numbers: Sequence[int], first_ms: int = 5000) -> None:
    assert [frame.sensor_ms for frame in frames] == [
        (first_ms + number * PERIOD_MS) % 2**32 for number in numbers
    ]
    for frame, number in zip(frames, numbers, strict=True):
        np.testing.assert_array_equal(frame.pressure, counts_of(number))


def contents(frames: Sequence[Frame]) -> list[tuple[int, int, bytes]]:
    return [(frame.number, frame.sensor_ms, frame.pressure.tobytes()) for frame in frames]


# --- what a frame is ---------------------------------------------------------------------------------------


def test_a_10x10_pad_cropped_and_inverted_gives_the_8x8_of_the_haart_recipe() -> None:
    raw = np.random.default_rng(0).integers(0, 1024, (10, 10)).astype("<u2")
    times = [7, 26]
    data = b"".join(
        b"\xff\xff\xff\xff"
        + time.to_bytes(4, "little")
        + raw.tobytes()
        + bytes([(int(raw.sum()) + time) % 256])
        for time in times
    )
    frames = FabricGrid(rows=10, columns=10, crop=1, invert=True).feed(data, 3.5)
    assert [frame.sensor_ms for frame in frames] == times
    np.testing.assert_array_equal(frames[0].pressure, 1023 - raw[1:9, 1:9])
    assert frames[0].pressure.dtype == np.uint16
    assert frames[0].host_s == 3.5


def test_an_8x8_pad_without_inversion_is_taken_as_it_is() -> None:
    data = b"".join(
        encode_fabric_grid(counts_of(1), ms, rows=8, columns=8, crop=0, invert=False) for ms in (0, 19)
    )
    frames = FabricGrid(rows=8, columns=8, crop=0, invert=False).feed(data, 0.0)
    np.testing.assert_array_equal(frames[1].pressure, counts_of(1))


def test_the_border_of_a_larger_grid_feels_nothing() -> None:
    data = encode_fabric_grid(counts_of(1), 0)
    raw = np.frombuffer(data, "<u2", 100, 8).reshape(10, 10)
    assert len(data) == SIZE
    assert set(raw[0]) | set(raw[-1]) | set(raw[:, 0]) | set(raw[:, -1]) == {1023}


def test_pressure_cannot_be_written_to() -> None:
    frames = FabricGrid().feed(packets([0, 1]), 0.0)
    with pytest.raises(ValueError, match="read-only"):
        frames[0].pressure[0, 0] = 1


@pytest.mark.parametrize(("rows", "columns", "crop"), [(10, 10, 0), (10, 8, 1), (6, 6, -1), (0, 0, 0)])
def test_a_geometry_that_leaves_no_8x8_is_refused_with_what_to_do(rows: int, columns: int, crop: int) -> None:
    with pytest.raises(ProtocolError, match=f"rows {rows}, columns {columns} and crop {crop}.*10x10"):
        FabricGrid(rows, columns, crop)
    with pytest.raises(ProtocolError):
        CsvLines(rows, columns, crop)


# --- intact frames, however they arrive --------------------------------------------------------------------


@UNHURRIED
@given(cuts=st.lists(st.integers(0, 6 * SIZE)))
def test_frames_do_not_depend_on_how_the_bytes_were_cut(cuts: list[int]) -> None:
    parser = FabricGrid()
    assert_are(fed(parser, packets(range(6)), cuts), range(6))
    assert parser.counts.bad == parser.counts.bytes_dropped == 0


def test_frames_come_one_byte_at_a_time() -> None:
    parser = FabricGrid()
    data = packets(range(4))
    frames = fed(parser, data, range(1, len(data)))
    assert_are(frames, range(4))
    assert [frame.number for frame in frames] == [0, 1, 2, 3]


def test_a_long_recording_fed_at_once_comes_out_whole() -> None:
    parser = FabricGrid()
    assert_are(parser.feed(packets(range(200)), 0.0), range(200))
    assert parser.counts.frames == 200


def test_a_frame_is_there_with_its_last_byte_and_bears_its_arrival() -> None:
    parser = FabricGrid()
    parser.feed(packets([0, 1]) + packet(2)[:-1], 10.0)
    (frame,) = parser.feed(packet(2)[-1:], 11.0)
    assert (frame.sensor_ms, frame.host_s) == (5000 + 2 * PERIOD_MS, 11.0)


@pytest.mark.parametrize("cut", [1, 3, 4, 7, 8, 9, 100, SIZE - 1])
def test_a_stream_joined_in_the_middle_of_a_frame_begins_with_the_next(cut: int) -> None:
    assert_are(FabricGrid().feed(packets(range(4))[cut:], 0.0), [1, 2, 3])


# --- damage ------------------------------------------------------------------------------------------------


@UNHURRIED
@given(bit=st.sampled_from([*HEADER_BITS, *TIME_BITS, *VISIBLE_VALUE_BITS, *CHECKSUM_BITS]))
def test_a_frame_with_a_flipped_bit_never_gets_through_and_is_counted(bit: int) -> None:
    parser = FabricGrid()
    data = packets([0, 1]) + flip(packet(2), bit) + packets([3, 4])
    assert_are(fed(parser, data, range(0, len(data), 50)), [0, 1, 3, 4])
    assert parser.counts.bad >= 1


@pytest.mark.parametrize(
    ("bit", "reason"),
    [(0, "bad_framing"), (40, "bad_time"), (64, "bad_checksum"), (64 + 12, "bad_value")],
)
def test_each_kind_of_damage_is_counted_once_and_by_name(bit: int, reason: str) -> None:
    parser = FabricGrid()
    parser.feed(packets([0, 1]) + flip(packet(2), bit) + packets([3, 4]), 0.0)
    assert getattr(parser.counts, reason) == parser.counts.bad == 1


@pytest.mark.parametrize("kept", [*range(1, 12), 100, SIZE - 3, SIZE - 2, SIZE - 1])
def test_a_frame_cut_off_costs_only_itself(kept: int) -> None:
    parser = FabricGrid()
    data = packets([0, 1]) + packet(2)[:kept] + packets([3, 4])
    assert_are(parser.feed(data, 0.0), [0, 1, 3, 4])
    assert parser.counts.bad >= 1
    assert parser.counts.bytes_dropped == kept


@pytest.mark.parametrize("length", range(1, 20))
def test_a_header_that_begins_in_a_run_of_ff_is_found(length: int) -> None:
    for number in range(2, 40):
        data = packets([0, 1]) + b"\xff" * length + packets([number, number + 1])
        assert_are(FabricGrid().feed(data, 0.0), [0, 1, number, number + 1])


def test_a_false_frame_with_a_right_checksum_does_not_hide_the_true_one_inside_it() -> None:
    """Two bytes of FF before a header make a window two bytes early; one in 256 passes every other check."""
    found = 0
    for number in range(2, 800):
        false = np.frombuffer(b"\xff\xff" + packet(number)[:-2], np.uint8)
        if int(false[4:8].sum() + false[8:-1:2].sum()) % 256 == false[-1]:
            data = packets([0, 1]) + b"\xff\xff" + packets([number, number + 1])
            parser = FabricGrid()
            assert_are(parser.feed(data, 0.0), [0, 1, number, number + 1])
            found += 1
    assert found > 0


def test_a_long_run_of_garbage_counts_as_the_frames_it_took_the_place_of() -> None:
    parser = FabricGrid()
    assert_are(parser.feed(packets([0, 1]) + b"\x55" * (3 * SIZE) + packets([2, 3]), 0.0), range(4))
    assert (parser.counts.bad_framing, parser.counts.bytes_dropped) == (3, 3 * SIZE)


def test_two_damaged_frames_in_a_row_are_counted_as_two() -> None:
    parser = FabricGrid()
    damaged = flip(packet(2), 64) + flip(packet(3), 0)
    assert_are(parser.feed(packets([0, 1]) + damaged + packets([4, 5]), 0.0), [0, 1, 4, 5])
    assert (parser.counts.bad_checksum, parser.counts.bad_framing) == (1, 1)


INTACT, FLIPPED, CUT_OFF, GARBAGE = "intact", "flipped", "cut off", "garbage"
noise = st.one_of(st.binary(max_size=40), st.integers(1, 40).map(lambda length: b"\xff" * length))
mishaps = st.one_of(
    st.just((INTACT, 0)),
    st.tuples(st.just(FLIPPED), st.sampled_from([*HEADER_BITS, *VISIBLE_VALUE_BITS, *CHECKSUM_BITS])),
    st.tuples(st.just(CUT_OFF), st.integers(1, SIZE - 2)),
    st.tuples(st.just(GARBAGE), noise),
)


@MANY
@given(line=st.lists(mishaps, max_size=12), cuts=st.lists(st.integers(0, 14 * SIZE), max_size=20))
def test_on_any_line_every_intact_frame_comes_out_once_and_in_order(
    line: list[tuple[str, int | bytes]], cuts: list[int]
) -> None:
    pieces, intact, stretches, in_damage = [packets([0, 1])], [0, 1], 0, False
    for number, (what, detail) in enumerate(line, 2):
        whole = packet(number)
        if what == INTACT:
            pieces.append(whole)
            intact.append(number)
        elif isinstance(detail, bytes):
            pieces.append(detail)
        else:
            pieces.append(flip(whole, detail) if what == FLIPPED else whole[:detail])
        damage = what != INTACT and pieces[-1] != b""
        stretches += damage and not in_damage
        in_damage = damage or (in_damage and what != INTACT)
    data = b"".join([*pieces, packets([20, 21])])
    parser = FabricGrid()
    assert_are(fed(parser, data, [cut for cut in cuts if cut < len(data)]), [*intact, 20, 21])
    assert parser.counts.bad >= stretches
    assert parser.counts.bytes_dropped == len(data) - SIZE * len([*intact, 20, 21])


soup = st.lists(
    st.one_of(
        noise,
        st.binary(max_size=3 * SIZE),
        st.integers(0, 60).map(packet),
        st.builds(lambda number, kept: packet(number)[:kept], st.integers(0, 60), st.integers(0, SIZE)),
        st.builds(
            lambda number, bit: flip(packet(number), bit), st.integers(0, 60), st.integers(0, SIZE * 8 - 1)
        ),
        st.integers(0, 2**32 - 1).map(lambda ms: encode_fabric_grid(counts_of(0), ms)),
        st.integers(2**32 - 40, 2**32 - 1).map(lambda ms: encode_fabric_grid(np.full((8, 8), 1023), ms)),
    ),
    max_size=15,
).map(b"".join)


@MANY
@given(data=soup, cuts=st.lists(st.integers(0, 3000), max_size=30))
def test_whatever_comes_in_the_cuts_change_nothing_and_memory_stays_bounded(
    data: bytes, cuts: list[int]
) -> None:
    whole, cut = FabricGrid(), FabricGrid()
    at_once = contents(whole.feed(data, 0.0))
    piecewise = []
    for start, stop in pairwise([0, *sorted(cuts), len(data)]):
        piecewise += cut.feed(data[start:stop], 0.0)
        assert cut.pending_bytes < 2 * SIZE
    assert contents(piecewise) == at_once
    assert cut.counts == whole.counts


def test_a_flood_of_headers_is_not_kept_and_the_frames_after_it_come_out() -> None:
    parser = FabricGrid()
    for _ in range(4):
        parser.feed(b"\xff" * 65536, 0.0)
        assert parser.pending_bytes < 2 * SIZE
    assert_are(parser.feed(packets([0, 1]), 0.0), [0, 1])


def test_a_flip_the_format_cannot_show_is_the_only_one_that_passes() -> None:
    bits = set(range(64, SIZE * 8 - 8)) - set(VISIBLE_VALUE_BITS)
    assert {(bit - 64) % 16 for bit in bits} == {8, 9}
    for bit in sorted(bits)[::20]:
        parser = FabricGrid()
        assert len(parser.feed(packets([0, 1]) + flip(packet(2), bit), 0.0)) == 3


# --- the sensor's clock ------------------------------------------------------------------------------------


def test_the_wrap_of_the_clock_after_49_days_is_nothing_special() -> None:
    first_ms = 2**32 - 3 * PERIOD_MS
    parser = FabricGrid()
    assert_are(parser.feed(packets(range(8), first_ms), 0.0), range(8), first_ms)
    assert parser.counts.bad == 0


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


def test_after_a_reboot_amid_garbage_and_damage_no_intact_frame_is_lost() -> None:
    parser = FabricGrid()
    wrong_clock = encode_fabric_grid(counts_of(9), 123_456_789)
    rebooted = (
        packet(0, 0) + b"ets Jun  8 2016\r\n" + wrong_clock + flip(packet(1, 0), 70) + packets([2, 3], 0)
    )
    frames = parser.feed(packets(range(3)) + rebooted, 0.0)
    assert_are(frames[:3], range(3))
    assert_are(frames[3:], [0, 2, 3], 0)
    assert (parser.counts.bad_time, parser.counts.bad_checksum, parser.counts.bad_framing) == (1, 1, 1)


def test_after_a_gap_of_seconds_the_stream_goes_on() -> None:
    parser = FabricGrid()
    assert_are(parser.feed(packets([0, 1, 500, 501, 502]), 0.0), [0, 1, 500, 501, 502])
    assert parser.counts.bad == 0


def test_a_single_frame_whose_clock_jumps_is_refused_when_the_next_one_disagrees() -> None:
    parser = FabricGrid()
    assert_are(parser.feed(packets([0, 1, 900, 2, 3]), 0.0), [0, 1, 2, 3])
    assert parser.counts.bad_time == 1


def test_a_frame_sent_twice_comes_out_once() -> None:
    parser = FabricGrid()
    assert_are(parser.feed(packets([0, 0, 1, 1, 1, 2]), 0.0), [0, 1, 2])
    assert (parser.counts.duplicates, parser.counts.bad) == (3, 0)


def test_frames_played_again_out_of_order_do_not_turn_the_clock_back() -> None:
    parser = FabricGrid()
    assert_are(parser.feed(packets([0, 1, 2, 3, 2, 3, 4, 5]), 0.0), range(6))


def test_a_clock_that_never_agrees_with_itself_keeps_a_bounded_number_of_frames() -> None:
    parser = FabricGrid()
    assert parser.feed(packets(range(0, 100_000, 1000)), 0.0) == []
    assert parser.counts.bad_time >= 90


def test_a_reset_forgets_half_a_frame_and_the_clock_but_not_the_numbers() -> None:
    parser = FabricGrid()
    parser.feed(packets([0, 1]) + packet(2)[:50], 0.0)
    parser.reset()
    frames = parser.feed(packets([0, 1], 0), 0.0)
    assert_are(frames, [0, 1], 0)
    assert [frame.number for frame in frames] == [2, 3]
    assert parser.counts.bytes_dropped == 50


# --- lines of numbers --------------------------------------------------------------------------------------


def line(number: int) -> bytes:
    return encode_csv_line(counts_of(number), 5000 + number * PERIOD_MS)


def lines(numbers: Sequence[int]) -> bytes:
    return b"half a line\n" + b"".join(line(number) for number in numbers)


@UNHURRIED
@given(cuts=st.lists(st.integers(0, 2000)))
def test_lines_do_not_depend_on_how_the_bytes_were_cut(cuts: list[int]) -> None:
    parser = CsvLines()
    data = lines(range(6))
    assume(all(cut < len(data) for cut in cuts))
    assert_are(fed(parser, data, cuts), range(6))
    assert parser.counts.bad == 0


def test_the_first_line_is_never_used_for_it_may_be_half_a_line() -> None:
    parser = CsvLines()
    assert_are(parser.feed(line(0)[2:] + line(1) + line(2), 0.0), [1, 2])
    assert parser.counts.bad == 0


def test_lines_without_a_clock_bear_their_arrival_on_the_host() -> None:
    parser = CsvLines()
    printed = encode_csv_line(counts_of(3), None)
    parser.feed(printed, 1.0)
    (frame,) = parser.feed(printed, 2.5)
    assert (frame.sensor_ms, frame.host_s) == (2500, 2.5)
    np.testing.assert_array_equal(frame.pressure, counts_of(3))


@pytest.mark.parametrize("separator", [b", ", b";", b" ", b"\t", b" , "])
def test_lines_may_use_any_usual_separator_and_line_end(separator: bytes) -> None:
    data = lines(range(3)).replace(b",", separator).replace(b"\n", b"\r\n\r\n")
    assert_are(CsvLines().feed(data, 0.0), range(3))


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (b"hello\n", "bad_framing"),
        (line(2)[:100] + b"\n", "bad_framing"),
        (line(2).replace(b",", b",,x", 1), "bad_framing"),
        (line(2).replace(b",", b",-", 1), "bad_framing"),
        (b"1" + line(2)[:-1] + b"7,9\n", "bad_framing"),
        (line(2)[:-1] + b"00000\n", "bad_value"),
        (b"99999999999" + line(2)[4:], "bad_value"),
        (b"9" + line(2), "bad_time"),
        (b"\xff\xfe\x00\n", "bad_framing"),
        (b"1," * 100_000 + b"1\n", "bad_framing"),
    ],
)
def test_a_bad_line_is_refused_and_counted_by_name(bad: bytes, reason: str) -> None:
    parser = CsvLines()
    frames = fed(parser, lines([0, 1]) + bad + line(3) + line(4), range(0, 3000, 70))
    assert_are(frames, [0, 1, 3, 4])
    assert getattr(parser.counts, reason) == parser.counts.bad == 1


def test_a_line_that_never_ends_is_not_kept() -> None:
    parser = CsvLines()
    parser.feed(lines([0, 1]), 0.0)
    for _ in range(100):
        parser.feed(b"1,2,3," * 1000, 0.0)
        assert parser.pending_bytes <= 101 * 12
    assert_are(parser.feed(b"\n" + line(2), 0.0), [2])
    assert parser.counts.bad_framing == 1


def test_one_line_that_lost_its_clock_does_not_pass_for_a_pad_without_one() -> None:
    parser = CsvLines()
    without_clock = line(2).split(b",", 1)[1]
    assert_are(parser.feed(lines([0, 1]) + without_clock + line(3), 0.0), [0, 1, 3])
    assert parser.counts.bad_framing == 1


def test_a_pad_that_changes_its_layout_for_good_is_understood_again() -> None:
    parser = CsvLines()
    parser.feed(lines([0, 1]), 0.0)
    frames = parser.feed(encode_csv_line(counts_of(5), None) * 5, 9.0)
    assert [frame.sensor_ms for frame in frames] == [9000, 9000, 9000]


printed_soup = st.lists(
    st.one_of(
        st.integers(0, 60).map(line),
        st.binary(max_size=200),
        st.text("0123456789,; \n", max_size=400).map(str.encode),
        st.just(encode_csv_line(counts_of(0), None)),
    ),
    max_size=12,
).map(b"".join)


@UNHURRIED
@given(data=printed_soup, cuts=st.lists(st.integers(0, 3000), max_size=20))
def test_whatever_is_printed_the_cuts_change_nothing_and_memory_stays_bounded(
    data: bytes, cuts: list[int]
) -> None:
    whole, cut = CsvLines(), CsvLines()
    at_once = contents(whole.feed(data, 0.0))
    piecewise = []
    for start, stop in pairwise([0, *sorted(cuts), len(data)]):
        piecewise += cut.feed(data[start:stop], 0.0)
        assert cut.pending_bytes <= 101 * 12
    assert contents(piecewise) == at_once
    assert cut.counts == whole.counts
