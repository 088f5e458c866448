"""Lines of numbers become frames: whole lines once and in order, bad ones counted, none too long kept."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from rigs.formats import CsvLines, encode_csv_line
from rigs.wire import PERIOD_MS, UNHURRIED, assert_are, contents, counts_of, fed


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


def test_the_first_line_may_be_half_and_is_skipped() -> None:
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


def test_one_line_without_a_clock_is_no_clockless_pad() -> None:
    parser = CsvLines()
    without_clock = line(2).split(b",", 1)[1]
    assert_are(parser.feed(lines([0, 1]) + without_clock + line(3), 0.0), [0, 1, 3])
    assert parser.counts.bad_framing == 1


def test_a_pad_may_change_its_layout() -> None:
    parser = CsvLines()
    parser.feed(lines([0, 1]), 0.0)
    frames = parser.feed(encode_csv_line(counts_of(5), None) * 5, 9.0)
    assert [frame.number for frame in frames] == [2, 3, 4]


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
def test_chunking_of_lines_changes_nothing_and_memory_stays_bounded(data: bytes, cuts: list[int]) -> None:
    whole, cut = CsvLines(), CsvLines()
    at_once = contents(whole.feed(data, 0.0))
    piecewise = []
    for start, stop in pairwise([0, *sorted(cuts), len(data)]):
        piecewise += cut.feed(data[start:stop], 0.0)
        assert cut.pending_bytes <= 101 * 12
    assert contents(piecewise) == at_once
    assert cut.counts == whole.counts
