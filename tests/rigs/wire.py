"""Whole and damaged frames on a wire, for the tests of the parsers."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from rigs.formats import encode_fabric_grid

from touchd.drivers.frame import Counts, Frame
from touchd.drivers.pad.parser import FrameParser

PERIOD_MS = 19
SIZE = 4 + 4 + 2 * 100 + 1
TIME_BITS = range(32, 64)
# The upper byte of a value does not enter the checksum: no reader can see it flip.
VISIBLE_VALUE_BITS = [64 + 16 * value + bit for value in range(100) for bit in range(8)]
VISIBLE_BITS = [*range(64), *VISIBLE_VALUE_BITS, *range(SIZE * 8 - 8, SIZE * 8)]


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


def fed(parser: FrameParser, data: bytes, cuts: Sequence[int] = ()) -> list[Frame]:
    edges = [0, *sorted(cuts), len(data)]
    pieces = [data[start:stop] for start, stop in pairwise(edges)]
    return [frame for piece in pieces for frame in parser.feed(piece, 1.0)]


def assert_are(frames: Sequence[Frame], numbers: Sequence[int], first_ms: int = 5000) -> None:
    assert [frame.sensor_ms for frame in frames] == [
        (first_ms + number * PERIOD_MS) % 2**32 for number in numbers
    ]
    for frame, number in zip(frames, numbers, strict=True):
        np.testing.assert_array_equal(frame.pressure, counts_of(number))


def read_too_fast(data: bytes, times: int) -> bytes:
    """Return what a port reads at `times` the baud rate of the bytes: it sees each bit that many times."""
    sent = [bit for byte in data for bit in (0, *(byte >> place & 1 for place in range(8)), 1)]
    bits = [bit for bit in sent for _ in range(times)]
    read, at = bytearray(), 0
    while at + 10 <= len(bits):
        if bits[at] == 0:
            read.append(sum(bit << place for place, bit in enumerate(bits[at + 1 : at + 9])))
            at += 9
        at += 1
    return bytes(read)
