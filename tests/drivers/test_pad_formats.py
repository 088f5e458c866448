"""Every parser's promises for every format: frames in order, damage counted, memory bounded."""

import math
import random
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from typing import Literal

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rigs.wire import counts_of

from touchd.drivers.fakes.encode import encode_frame, encode_values, values_of
from touchd.drivers.frame import Frame
from touchd.drivers.pad.binary import frame_bytes
from touchd.drivers.pad.format import PRESETS, FormatError, Layout, PadFormat
from touchd.drivers.pad.parser import FrameParser

MORE = {
    "packed 12 bit": PadFormat(
        header="a5 5a", cell="u12", rows=16, columns=16, full_scale=4095, checksum="xor8"
    ),
    "header in ASCII": PadFormat(
        header="0d 0a fe fe", rows=8, columns=8, clock="ms", order="big", full_scale=4095
    ),
    "sum of bytes": PadFormat(header="f0f0f0", cell="u8", rows=8, columns=8, full_scale=239, checksum="sum8"),
    "rows to a flag": PadFormat(framing="text", rows=16, columns=12, end="flag"),
    "numbered rows": PadFormat(framing="text", rows=6, columns=5, skip=1, end="--"),
    "signed text between others": PadFormat(framing="text", rows=40, columns=30, skip=2, tail=1),
    "one byte of header": PadFormat(header="ff", cell="u8", rows=8, columns=8, full_scale=250),
    "skip and tail": PadFormat(header="aa55", skip=8, tail=2, rows=12, columns=8),
    "tail and checksum": PadFormat(header="aa55", skip=1, tail=2, rows=4, columns=6, checksum="sum8"),
    "signed": PadFormat(header="aa55aa", cell="i16", order="big", rows=8, columns=8, full_scale=32767),
    "floats": PadFormat(header="aa55aa55", cell="f32", rows=8, columns=8),
    "32x32": PadFormat(header="aaabac", clock="ms", rows=32, columns=32, full_scale=4095),
    "4x4": PadFormat(header="aaabac", clock="ms", rows=4, columns=4),
    "sum without a clock": PadFormat(header="aaabac", rows=8, columns=8, checksum="values"),
}
FORMATS = PRESETS | MORE
every_format = pytest.mark.parametrize("described", FORMATS.values(), ids=FORMATS)
FEW = settings(deadline=None, max_examples=20)


@cache
def laid(described: PadFormat, number: int) -> bytes:
    """Return the pressure of `counts_of(number)` as sent through this format's grid."""
    layout = Layout(described)
    return layout.pressure(values_of(described, counts_of(number)).ravel()).tobytes()


@cache
def sent(described: PadFormat, number: int) -> bytes:
    return encode_frame(described, counts_of(number), 5000 + 19 * number)


def end_of(described: PadFormat) -> bytes:
    """Return the bytes that end a frame, so that the next frame is whole."""
    return b"" if described.framing == "binary" else f"\n{described.end}\n".encode()


def stream(described: PadFormat, numbers: Sequence[int]) -> bytes:
    """Return these frames, after half a frame in formats whose frames are found by their ends."""
    begun = sent(described, 99)[-9:] if described.framing != "binary" else b""
    return begun + b"".join(sent(described, number) for number in numbers)


def feed(parser: FrameParser, data: bytes, cuts: Sequence[int] = ()) -> list[Frame]:
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    frames: list[Frame] = []
    for start, stop in pairwise(edges):
        frames += parser.feed(data[start:stop], 1.0)
        assert len(parser._framing.buffer) <= 2 * longest(parser.format)
    return frames


def longest(described: PadFormat) -> int:
    if described.framing == "binary":
        return frame_bytes(described)
    return 24 * (described.cells + described.skip + described.tail) + 256


def assert_are(described: PadFormat, frames: Sequence[Frame], numbers: Sequence[int]) -> None:
    assert [frame.pressure.tobytes() for frame in frames] == [laid(described, number) for number in numbers]
    stamps = [frame.sensor_ms for frame in frames]
    assert stamps == sorted(stamps)


@every_format
@given(cuts=st.lists(st.integers(0, 20_000), max_size=12))
@FEW
def test_frames_come_whole_and_in_order_in_any_chunks(described: PadFormat, cuts: list[int]) -> None:
    parser = FrameParser(described)
    assert_are(described, feed(parser, stream(described, range(5)), cuts), range(5))
    assert parser.counts.bad == 0


@every_format
@pytest.mark.parametrize("kept", [0.02, 0.4, 0.97])
def test_a_truncated_frame_is_lost_alone_and_counted(described: PadFormat, kept: float) -> None:
    parser = FrameParser(described)
    whole = sent(described, 2)
    broken = whole[: max(1, round(kept * len(whole)))]
    # A printed line without its end would merge with the next.
    broken += end_of(described) if described.framing == "text" else b""
    data = stream(described, [0, 1]) + broken + b"".join(sent(described, n) for n in (3, 4, 5))
    came = {frame.pressure.tobytes() for frame in feed(parser, data, range(0, len(data), 97))}
    assert {laid(described, number) for number in (0, 1, 4, 5)} <= came
    # A frame that lost only part of its end still has all its cells.
    assert laid(described, 2) not in came or (described.end and kept > 0.9)
    # A separate line with a few numbers may be other output of the pad, which does not count as bad.
    assert parser.counts.bad >= (described.framing == "binary" or (kept > 0.9 and not described.end))


@every_format
def test_garbage_is_counted_and_loses_no_intact_frame(described: PadFormat) -> None:
    parser = FrameParser(described)
    rng = random.Random(1)
    garbage = bytes(rng.choice(b"\x00\x07uxyz") for _ in range(3 * longest(described)))
    data = stream(described, [0, 1]) + garbage + end_of(described)
    data += b"".join(sent(described, number) for number in (2, 3, 4))
    assert_are(described, feed(parser, data, range(0, len(data), 211)), range(5))
    assert parser.counts.bad >= 1


@every_format
@given(
    pieces=st.lists(st.one_of(st.binary(max_size=300), st.integers(0, 9)), max_size=10),
    cuts=st.lists(st.integers(0, 9999), max_size=9),
)
@FEW
def test_chunk_boundaries_never_change_the_result(
    described: PadFormat, pieces: list[bytes | int], cuts: list[int]
) -> None:
    data = b"".join(sent(described, one) if isinstance(one, int) else one for one in pieces)
    whole, cut = FrameParser(described), FrameParser(described)
    at_once = [(frame.sensor_ms, frame.pressure.tobytes()) for frame in whole.feed(data, 1.0)]
    assert [(frame.sensor_ms, frame.pressure.tobytes()) for frame in feed(cut, data, cuts)] == at_once
    assert cut.counts == whole.counts


@every_format
def test_an_endless_line_is_not_buffered(described: PadFormat) -> None:
    floods = (b"\xff" * 5000, b"1," * 2500, b"1\n" * 2500, described.header_bytes * 1500 or b" " * 5000)
    for flood in floods:
        parser = FrameParser(described)
        for _ in range(4 * longest(described) // len(flood) + 1):
            parser.feed(flood, 1.0)
            assert len(parser._framing.buffer) <= 2 * longest(described)
            assert len(getattr(parser._framing, "_run", ())) <= 2 * described.cells


@every_format
def test_values_above_full_scale_are_cut_to_it(described: PadFormat) -> None:
    upright = msgspec.structs.replace(described, invert=False)
    parser = FrameParser(msgspec.structs.replace(upright, full_scale=described.full_scale // 2))
    frames = [encode_frame(upright, np.full((8, 8), 1000, np.uint16), 5 + 9 * number) for number in range(4)]
    came = parser.feed(end_of(described) + b"".join(frames), 1.0)
    assert came
    # Cells that are cropped are at rest.
    assert all((frame.pressure == 1023).all() for frame in came)
    assert parser.counts.clipped == len(came)
    assert parser.counts.bad == 0


@pytest.mark.parametrize("values", [(-3, 7), (-3.5, 7.25), (-30000, 700)], ids=["whole", "points", "large"])
def test_negative_values_are_cut_at_0(values: tuple[float, float]) -> None:
    parser = FrameParser(PadFormat(framing="text", rows=8, columns=8, full_scale=1023))
    line = ",".join(map(str, values * 32)).encode() + b"\n"
    (frame,) = parser.feed(b"\n" + line, 1.0)
    assert frame.pressure.ravel().tolist() == [0, round(values[1])] * 32
    signed = PadFormat(header="aa55aa", cell="i16", rows=8, columns=8)
    sent = encode_values(signed, np.array(values * 32).astype(np.int16), None) + b"\xaa\x55\xaa"
    (frame,) = FrameParser(signed).feed(sent, 1.0)
    assert frame.pressure.ravel().tolist() == [0, int(values[1])] * 32


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_frame_with_an_infinite_or_nan_cell_is_refused(value: float) -> None:
    described = MORE["floats"]
    cells = counts_of(9).astype(np.float32)
    cells[3, 5] = value
    parser = FrameParser(described)
    data = sent(described, 0) + encode_values(described, cells, None) + sent(described, 1)
    assert_are(described, parser.feed(data + described.header_bytes, 1.0), [0, 1])
    assert parser.counts.damaged == parser.counts.bad == 1


@pytest.mark.parametrize(("order", "cells"), [("big", [0xABC, 0xDEF]), ("little", [0xDAB, 0xEFC])])
def test_two_cells_of_12_bits_take_three_bytes(order: Literal["big", "little"], cells: list[int]) -> None:
    described = PadFormat(header="aaabac", cell="u12", order=order, rows=4, columns=4, full_scale=4095)
    (frame,) = FrameParser(described).feed(b"\xaa\xab\xac" + b"\xab\xcd\xef" * 8 + b"\xaa\xab\xac", 0.0)
    sent = np.tile(np.array(cells, np.uint16), 8)
    np.testing.assert_array_equal(frame.pressure, Layout(described).pressure(sent))


@pytest.mark.parametrize("kind", ["values", "sum8", "xor8"])
def test_a_frame_with_any_other_checksum_is_refused(kind: Literal["values", "sum8", "xor8"]) -> None:
    described = PadFormat(header="aa55aa", rows=8, columns=8, checksum=kind)
    whole = sent(described, 0)
    for off in (1, 2, 254, 255):
        parser = FrameParser(described)
        damaged = whole[:-1] + bytes([(whole[-1] + off) % 256])
        assert_are(described, parser.feed(damaged + whole, 1.0), [0])
        assert parser.counts.damaged == parser.counts.bad == 1


def test_a_datagram_is_a_frame_or_is_refused() -> None:
    described = PadFormat(cell="u8", rows=8, columns=8, full_scale=255)
    parser = FrameParser(described)
    whole = encode_frame(described, counts_of(0), None)
    frames = [len(parser.feed(data, 1.0)) for data in (whole, b"", whole[:-1], whole + b"x", whole)]
    assert frames == [1, 0, 0, 0, 1]
    assert parser.counts.damaged == 2


@pytest.mark.parametrize("cell", ["u8", "u12", "u16"])
@pytest.mark.parametrize("kind", ["xor8", "none"])
def test_cells_that_begin_with_a_short_header_lose_no_frame(cell: str, kind: str) -> None:
    described = PadFormat(header="9a", cell=cell, rows=8, columns=8, full_scale=255, checksum=kind)
    pressed = np.full((8, 8), 7, np.uint16)
    pressed[0, 0] = 0x9A
    frames = [encode_values(described, cells, None) for cells in (pressed - 7, pressed, pressed - 7) * 4]
    parser = FrameParser(described)
    assert len(feed(parser, b"".join(frames) + bytes.fromhex(described.header))) == len(frames)
    assert parser.counts.bad == 0


def test_a_finer_grid_is_pooled_and_a_coarser_one_interpolated() -> None:
    fine = Layout(PadFormat(header="aa", rows=16, columns=32))
    grid = np.random.default_rng(0).integers(0, 1024, (16, 32)).astype(np.uint16)
    pooled = grid.reshape(8, 2, 8, 4).mean(axis=(1, 3))
    assert np.abs(fine.pressure(grid.ravel()) - pooled).max() <= 0.5
    ramp = np.repeat(np.arange(4, dtype=np.uint16)[:, None] * 100, 4, axis=1)
    coarse = Layout(PadFormat(header="aa", rows=4, columns=4)).pressure(ramp.ravel())
    assert coarse[:, 0].tolist() == [0, 25, 75, 125, 175, 225, 275, 300]


def test_a_pad_is_turned_then_mirrored() -> None:
    grid = np.arange(64, dtype=np.uint16).reshape(8, 8)
    for turn in (0, 90, 180, 270):
        described = PadFormat(header="aa", rows=8, columns=8, turn=turn, mirror=True)  # type: ignore[arg-type]
        laid = Layout(described).pressure(grid.ravel())
        np.testing.assert_array_equal(laid, np.rot90(grid, -turn // 90)[:, ::-1])
        np.testing.assert_array_equal(values_of(described, laid), grid)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"framing": "text", "header": "aa"}, "header is not for a text format"),
        ({"framing": "text", "cell": "u8"}, "cell is not for a text format"),
        ({"header": "aa", "end": "x"}, "end is not for a binary format"),
        ({"header": "xyz"}, "header 'xyz' is not bytes in hex"),
        ({"header": " "}, "header ' ' is not bytes in hex"),
        ({"rows": 10, "crop": 4, "header": "aa"}, "10x10 with crop 4 leaves 2x2"),
        ({"header": "aa", "cell": "u8"}, "full_scale 1023 does not fit into a cell of u8"),
    ],
)
def test_a_description_that_contradicts_itself_is_refused(fields: dict[str, object], message: str) -> None:
    with pytest.raises(FormatError, match=message):
        PadFormat(**fields)  # type: ignore[arg-type]
