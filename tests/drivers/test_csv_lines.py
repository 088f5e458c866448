"""Lines of numbers become frames, whole and in order; bad lines are counted."""

from collections.abc import Sequence

import numpy as np
import pytest
from rigs.formats import CsvLines, encode_csv_line
from rigs.wire import PERIOD_MS, assert_are, counts_of, fed

from touchd.drivers.pad.format import Layout, PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.text import numbers_in


def line(number: int) -> bytes:
    return encode_csv_line(counts_of(number), 5000 + number * PERIOD_MS)


def lines(numbers: Sequence[int]) -> bytes:
    return b"half a line\n" + b"".join(line(number) for number in numbers)


@pytest.mark.parametrize("separator", [b", ", b";", b" ", b"\t", b" , "])
def test_lines_may_use_any_usual_separator_and_line_end(separator: bytes) -> None:
    data = lines(range(3)).replace(b",", separator).replace(b"\n", b"\r\n\r\n")
    assert_are(CsvLines().feed(data, 0.0), range(3))


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (line(2)[:300] + b"\n", "damaged"),
        (line(2).replace(b",", b",,x", 1), "damaged"),
        (b"1" + line(2)[:-1] + b"7,9\n", "damaged"),
        (b"9" + line(2), "bad_time"),
        (b"1," * 100_000 + b"1\n", "damaged"),
        (line(2).split(b",", 1)[1], "damaged"),
        (line(2)[:-1] + b"1,1\n", "damaged"),
        (b"1," * 50 + b"1\n", "damaged"),
    ],
)
def test_a_bad_line_is_refused_and_counted_by_name(bad: bytes, reason: str) -> None:
    parser = CsvLines()
    frames = fed(parser, lines([0, 1]) + bad + line(3) + line(4), range(0, 3000, 70))
    assert_are(frames, [0, 1, 3, 4])
    assert getattr(parser.counts, reason) == parser.counts.bad == 1


@pytest.mark.parametrize(
    "other",
    [
        *(b"", b"hello\n", b"\n\n\n", b"7\n", b"\xff\xfe\x00\n", b"# a comment\n\n"),
        *(b"I (123) wifi: rssi=-61\n", line(2)[:100] + b"\n", b"1," * 49 + b"1\n"),
    ],
)
def test_other_output_of_the_pad_is_not_counted_as_damage(other: bytes) -> None:
    parser = CsvLines()
    assert_are(parser.feed(lines([0, 1]) + other + line(3), 0.0), [0, 1, 3])
    assert parser.counts.bad == 0


def test_a_number_of_thousands_of_digits_is_clipped() -> None:
    parser = FrameParser(PadFormat(framing="text", rows=32, columns=32))
    (frame,) = parser.feed(b"\n" + b"0," * 1023 + b"1" * 5000 + b"\n", 0.0)
    assert frame.pressure[-1, -1] == 64
    assert parser.counts.clipped == 1


ROWS = [[10 * row + column for column in range(6)] for row in range(5)]
CELLS = [cell for cells in ROWS for cell in cells]
NUMBERED = [f"{row},{','.join(map(str, cells))}" for row, cells in enumerate(ROWS)]


@pytest.mark.parametrize(
    ("printed", "skip"),
    [
        ("\n".join(",".join(map(str, cells)) for cells in ROWS) + "\n\n", 0),
        ("START\r\n" + "\r\n".join("\t".join(map(str, cells)) for cells in ROWS) + "\r\n", 0),
        ("FRAME,12\n" + "".join(" ".join(map(str, cells)) + " \n" for cells in ROWS), 0),
        ("".join(f"Row {row}: {cells}\n" for row, cells in enumerate(ROWS)), 0),
        ("".join(f"R{row} {cells}\n" for row, cells in enumerate(ROWS)), 0),
        ("\n".join(NUMBERED) + "\n", 1),
        ("\r".join(NUMBERED) + "\r", 1),
        ("".join(f"A{number}: {cell}\r\n" for number, cell in enumerate(CELLS)), 0),
        (f"\x1b[2J\x1b[H{ROWS}\n", 0),
        ("12:34:05.125 -> " + str(ROWS) + "\r\n", 1),
        ("".join("x".join(map(str, [f"z{row}", *cells])) + "\r\n" for row, cells in enumerate(ROWS)), 0),
        ("$" + ",".join(map(str, CELLS)) + "*5A\r\n", 0),
        ("mV " + " ".join(f"{cell}mV" for cell in CELLS) + "\n", 0),
        (" ".join(f"0x{cell:02X}" for cell in CELLS) + "\n", 0),
    ],
)
def test_numbers_are_read_whatever_stands_around_them(printed: str, skip: int) -> None:
    described = PadFormat(framing="text", rows=5, columns=6, skip=skip)
    parser = FrameParser(described)
    frames = parser.feed(printed.encode() * 4, 0.0)
    # The first frame is dropped if it may be incomplete; a frame of several lines ends where the next begins.
    assert 2 <= len(frames) <= 4
    expected = Layout(described).pressure(np.array(CELLS, np.uint16))
    for frame in frames:
        np.testing.assert_array_equal(frame.pressure, expected)
    assert parser.counts.bad == 0
    in_pieces = FrameParser(described)
    assert len(fed(in_pieces, printed.encode() * 4, range(0, 4 * len(printed), 7))) == len(frames)
    assert in_pieces.counts == parser.counts


@pytest.mark.parametrize(
    ("printed", "numbers", "label"),
    [
        (b"1 2.5 -3", [1, 2.5, -3], None),
        (b"3: 4 5", [4, 5], 3),
        (b"1.5: 4 5", [4, 5], None),
        (b"3: 7: 4 5", [4, 5], 3),
        (b"4 7: 5", [4, 5], None),
        (b"R3 A7 4 5", [4, 5], 3),
        (b"4 R3 5", [4, 5], None),
        (b"123456789: 4", [4], 123456789),
        (b"R1234567890 4", [4], 123456789),
        (b"0x1F nan NULL 1e3 .5", [31, 0, 0, 1000, 0.5], None),
        (b"hello", [], None),
    ],
)
def test_a_line_is_numbers_after_the_first_label(
    printed: bytes, numbers: list[float], label: int | None
) -> None:
    assert numbers_in(printed) == (numbers, label)


def test_a_wide_line_is_read_but_not_an_endless_one() -> None:
    described = PadFormat(framing="text", rows=4, columns=4, tail=3)
    wide = ("words " * 42 + "".join(f"{number:>24}" for number in range(19))).encode() + b"\n"
    parser = FrameParser(described)
    assert len(parser.feed(b"\n" + wide * 2, 0.0)) == 2
    assert parser.feed(b" " * 100 + wide, 0.0) == []
    assert parser.counts.damaged == 1


def test_a_damaged_line_loses_only_its_own_frame() -> None:
    described = PadFormat(framing="text", rows=5, columns=6)
    frame = "\n".join(",".join(map(str, cells)) for cells in ROWS) + "\n\n"
    for damaged in (
        frame.replace("10,11", "1011"),
        frame.replace("\n", "", 1),
        frame[:40] + "\n",
        "x" + frame[20:],
    ):
        parser = FrameParser(described)
        assert len(parser.feed((frame * 2 + damaged + frame * 2).encode(), 0.0)) == 3, damaged
        assert parser.counts.bad >= 1
    # A loss across the boundary of two frames costs both; their halves do not form a frame.
    parser = FrameParser(described)
    assert len(parser.feed((frame * 2 + frame[:40] + frame[20:] + frame * 2).encode(), 0.0)) <= 3


@pytest.mark.parametrize("place", range(5))
def test_a_damaged_line_before_an_end_loses_only_its_frame(place: int) -> None:
    parser = FrameParser(PadFormat(framing="text", rows=5, columns=6, end="end"))
    printed = [",".join(map(str, cells)) + "\n" for cells in ROWS]
    damaged = [*printed[:place], "7,7\n", *printed[place + 1 :]]
    sent = [*printed, "end\n"] * 2 + [*damaged, "end\n"] + [*printed, "end\n"] * 2
    assert len(parser.feed("".join(sent).encode(), 0.0)) == 3


def test_a_frame_with_an_end_may_contain_blank_lines() -> None:
    parser = FrameParser(PadFormat(framing="text", rows=5, columns=6, end="]]"))
    frame = str(np.array(ROWS)).replace("\n", "\n\n") + "\n"
    assert len(parser.feed(frame.encode() * 4, 0.0)) == 3
    assert parser.counts.bad == 0
