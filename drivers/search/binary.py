"""Finds the frames in bytes, and where a grid's cells may lie among them.

A header is a sequence of bytes that occurs once a frame: at a constant distance from the next, and hardly
ever in between.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from msgspec import convert
from msgspec.structs import replace
from numpy.typing import NDArray

from touchd.drivers.pad.binary import CELL_BITS, PLAIN_CELLS
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.search.neighbours import Numbers, Placement
from touchd.drivers.search.text import LEAST_FRAMES

# Bytes of a frame beside its cells: header, length, 64-bit clock, counter and checksum take 20.
MOST_AROUND = 32
# The fabric pad's header has four bytes, and eight hold a header and a length; what is longer is skipped. Two
# bytes hardly ever occur among cells by chance.
LONGEST_HEADER, SHORT_HEADER = 8, 2
# One frame in 65 may be damaged; the proof asks for 98 %.
STEADY_SHARE = 0.985
# A header may also occur among the cells by chance: a single byte does once in 256 random bytes.
STRAY, STRAY_A_BYTE = 1.5, 0.01
# A frame's length is a distance at which the same bytes, as many as one of these, recur so often that they
# cover this share of all. Chosen on the presets' streams; the length of the largest pad limits it.
GRAMS, COVERED, SHORTEST_LENGTH, LONGEST_LENGTH, LENGTH_BYTES = (1, 2, 3, 4), 0.6, 17, 17_000, 400_000
# Floats of a pad are zero or of a size between these; integers read as floats are not.
TINY_FLOAT, HUGE_FLOAT = 1e-9, 1e9


@dataclass(frozen=True, eq=False)
class Table:
    """Frames of one length: (frames, bytes), each from the header on, which occurs once a frame."""

    header: bytes
    frames: NDArray[np.uint8]


def counting(numbers: Numbers) -> NDArray[np.bool_]:
    """Whether each of (frames, numbers) is a clock or a counter: it rises in most frames and never falls."""
    steps = np.diff(numbers, axis=0)
    counts: NDArray[np.bool_] = (steps >= 0).all(axis=0) & (2 * (steps > 0).sum(axis=0) > len(steps))
    return counts


def tables(data: bytes) -> Iterator[Table]:
    """Yield the frames of each length at which the same bytes recur, that of most data first."""
    data = data[-LENGTH_BYTES:]
    part = np.frombuffer(data, np.uint8)
    found: dict[int, NDArray[np.int_]] = {}
    for size in GRAMS if len(part) > SHORTEST_LENGTH else ():
        for length, begins in _recurring(part, size):
            if len(begins) > len(found.get(length, ())):
                found[length] = begins
    for length, begins in sorted(found.items(), key=lambda each: -each[0] * len(each[1])):
        begins = begins[begins + 2 * length <= len(part)]
        if len(begins) >= LEAST_FRAMES:
            yield from _framed(part[begins[:, None] + np.arange(2 * length)], length, data)


def _framed(twice: NDArray[np.uint8], length: int, data: bytes) -> Iterator[Table]:
    """Yield frames from each header on, the longest first. twice: each frame and the next, from anywhere on.

    Zeros, and bytes before one that only rises, may be upper bytes of a counter, and change later.
    """
    usual = np.median(twice, axis=0).astype(np.uint8)
    steady = (twice == usual).mean(axis=0) >= STEADY_SHARE
    steps = np.diff(twice.astype(np.int16), axis=0)
    rises = np.logical_and((steps >= 0).all(axis=0), (steps > 0).any(axis=0))
    found: list[Table] = []
    for run in re.finditer(rb"[^\0]+", np.where(steady, usual, 0).astype(np.uint8).tobytes()):
        is_counter = rises[run.end() : run.end() + 1].any()
        header = run[0][: SHORT_HEADER if is_counter else LONGEST_HEADER]
        is_rare = data.count(header) <= _most(len(twice), length, len(header))
        if is_rare and run.start() < length:
            found.append(Table(header, twice[:, run.start() : run.start() + length]))
    yield from sorted(found, key=lambda table: -len(table.header))


def _recurring(part: NDArray[np.uint8], size: int) -> Iterator[tuple[int, NDArray[np.int_]]]:
    """Yield distances at which the same bytes, as many as `size`, recur, and where they do.

    They cover most of the data, and hardly ever occur elsewhere. Zeros may belong to a counter.
    """
    many = part.astype(np.int64)
    codes = np.sum([many[at : len(many) - size + 1 + at] << 8 * at for at in range(size)], axis=0)
    places = np.argsort(codes, kind="stable")
    codes, distances = codes[places], np.diff(places)
    fits = (codes[1:] == codes[:-1]) & (distances >= SHORTEST_LENGTH) & (distances <= LONGEST_LENGTH)
    kinds, starts = (codes[:-1] << 16 | distances)[fits], places[:-1][fits]
    each, times = np.unique(kinds, return_counts=True)
    for kind in each[times * (each & 0xFFFF) > COVERED * len(part)].tolist():
        code, length = kind >> 16, kind & 0xFFFF
        begins = starts[kinds == kind]
        if code and np.subtract(*np.searchsorted(codes, [code + 1, code])) <= _most(
            len(begins), length, size
        ):
            yield length, begins


def _most(frames: int, length: int, size: int) -> int:
    """Return how often a header may occur in frames of a length."""
    return int((STRAY + STRAY_A_BYTE * length if size == 1 else STRAY) * float(frames))


def placements(data: bytes, rows: int, columns: int) -> Iterator[Placement]:
    """Yield the placements of a grid's cells after the headers of the frames whose length fits."""
    for table in tables(data):
        for (kind, order), sent in PLAIN_CELLS.items():
            size = rows * columns * CELL_BITS[kind] // 8
            beside = table.frames.shape[1] - len(table.header) - size
            if not 0 <= beside < MOST_AROUND or (kind, order) == ("u8", "big"):
                continue
            fields = {"header": table.header.hex(), "cell": kind, "order": order, "full_scale": 1}
            described = replace(convert(fields, PadFormat), rows=rows, columns=columns)
            for skip in range(beside, -1, -1):
                begin = len(table.header) + skip
                values = _decoded(table.frames[:, begin : begin + size], sent)
                if values is not None:
                    yield Placement(replace(described, skip=skip, tail=beside - skip), values)


def _decoded(cells: NDArray[np.uint8], kind: str) -> Numbers | None:
    """Return (frames, cells) as sent; None for floats of which few have a usual size."""
    with np.errstate(invalid="ignore"):
        sent = np.ascontiguousarray(cells).view(kind).astype(np.float64)
        is_usual = (sent == 0) | ((np.abs(sent) > TINY_FLOAT) & (np.abs(sent) < HUGE_FLOAT))
    return np.where(is_usual, sent, 0) if is_usual.mean() >= STEADY_SHARE else None
