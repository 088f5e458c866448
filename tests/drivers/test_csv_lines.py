"""Lines of numbers become frames, whole and in order; bad lines are counted."""

from collections.abc import Sequence

import numpy as np
import pytest
from rigs.formats import CsvLines, encode_csv_line
from rigs.wire import PERIOD_MS, assert_are, counts_of, fed

from touchd.drivers.pad.diagnosis import diagnose
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.protocol import parser_of


def line(number: int) -> bytes:
    return encode_csv_line(counts_of(number), 5000 + number * PERIOD_MS)


def lines(numbers: Sequence[int]) -> bytes:
    return b"half a line\n" + b"".join(line(number) for number in numbers)


def test_lines_without_a_clock_carry_their_arrival_time() -> None:
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
        (line(2).split(b",", 1)[1], "bad_framing"),
    ],
)
def test_a_bad_line_is_refused_and_counted_by_name(bad: bytes, reason: str) -> None:
    parser = CsvLines()
    frames = fed(parser, lines([0, 1]) + bad + line(3) + line(4), range(0, 3000, 70))
    assert_are(frames, [0, 1, 3, 4])
    assert getattr(parser.counts, reason) == parser.counts.bad == 1


def test_a_number_of_thousands_of_digits_is_refused_and_diagnosed() -> None:
    large = PadFormat(framing="line", rows=32, columns=32)
    data = (b"0," * 1023 + b"1" * 5000 + b"\n") * 5
    parser = parser_of(large)
    assert parser.feed(data, 0.0) == []
    assert parser.counts.bad_framing == 4
    assert diagnose(data, large)[0] == "format"


def test_a_pad_may_change_its_layout() -> None:
    parser = CsvLines()
    parser.feed(lines([0, 1]), 0.0)
    frames = parser.feed(encode_csv_line(counts_of(5), None) * 5, 9.0)
    assert [frame.number for frame in frames] == [2, 3, 4]
