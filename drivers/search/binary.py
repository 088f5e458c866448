"""Finds the frames in binary data, and where a grid's cells may lie in them.

A header is a sequence of bytes that occurs once a frame: at a constant distance from the next, and hardly
ever in between.
"""

import re
from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from touchd.drivers.pad.binary import CELL_BITS, PLAIN_CELLS
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.search.proof import Cells, Numbers, Placement
from touchd.drivers.search.text import LEAST_FRAMES

# Bytes of a frame beside its cells: header, length, 64-bit clock, counter and checksum take 20.
MOST_AROUND = 32
# Eight bytes hold a header and a length; more are skipped. Two bytes hardly ever occur among cells by chance.
LONGEST_HEADER, SHORT_HEADER = 8, 2
# A header's byte may differ in one frame of 65, by damage; the proof asks for 98 %.
STEADY_SHARE = 0.985
# How often a header may also occur by chance, per byte of a frame: one random byte of 256 begins it.
STRAY = 0.01
# A frame's length is a distance at which the same n bytes recur, n from GRAMS, and which accounts for COVERED
# of the last LENGTH_BYTES. Chosen on the presets' streams; the largest pad's frame has LONGEST_LENGTH.
GRAMS, COVERED, SHORTEST_LENGTH, LONGEST_LENGTH, LENGTH_BYTES = (1, 2, 3, 4), 0.6, 17, 17_000, 400_000
# A pad's floats are zero, or of a size between these; integers read as floats are not.
TINY_FLOAT, HUGE_FLOAT = 1e-9, 1e9


def counting(numbers: Numbers) -> NDArray[np.bool_]:
    """Whether each of (frames, numbers) is a clock or a counter: it rises in most frames and never falls."""
    steps = np.diff(numbers, axis=0)
    counts: NDArray[np.bool_] = (steps >= 0).all(axis=0) & (2 * (steps > 0).sum(axis=0) > len(steps))
    return counts


def tables(data: bytes) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames of each likely length, the length that accounts for most data first.

    They are (frames, twice a frame's bytes), from an arbitrary byte of a frame on. Recurring zeros do not
    count, as they may be a counter's.
    """
    part = np.frombuffer(data[-LENGTH_BYTES:], np.uint8)
    found: dict[int, Cells] = {}
    for size in GRAMS if len(part) > SHORTEST_LENGTH else ():
        many = part.astype(np.int64)
        codes = np.sum([many[at : len(many) - size + 1 + at] << 8 * at for at in range(size)], axis=0)
        places = np.argsort(codes, kind="stable")
        codes, distances = codes[places], np.diff(places)
        fits = (codes[1:] == codes[:-1]) & (distances >= SHORTEST_LENGTH) & (distances <= LONGEST_LENGTH)
        fits &= codes[1:] > 0
        kinds, starts = (codes[:-1] << 16 | distances)[fits], places[:-1][fits]
        each, times = np.unique(kinds, return_counts=True)
        for kind in each[times * (each & 0xFFFF) > COVERED * len(part)].tolist():
            length, begins = kind & 0xFFFF, starts[kinds == kind]
            found[length] = max(found.get(length, begins), begins, key=len)
    for length, begins in sorted(found.items(), key=lambda each: -each[0] * len(each[1])):
        # Part of a header may recur inside it; keep beginnings whose next frame begins one length later.
        begins = begins[np.isin(begins + length, begins)]
        if len(begins) >= LEAST_FRAMES:
            yield part[begins[:, None] + np.arange(2 * length)]


def placements(data: bytes, rows: int, columns: int) -> Iterator[Placement]:
    """Yield the placements of a grid's cells in the frames of the lengths that fit.

    Their header is the longest run of constant bytes beside the cells. Zeros, and all but two of the bytes
    before one that only rises, are not used: they may be a counter's upper bytes, which change later.
    """
    for table in tables(data):
        length, usual = table.shape[1] // 2, np.median(table, axis=0).astype(np.uint8)
        steady = np.where((table == usual).mean(axis=0) >= STEADY_SHARE, usual, 0).astype(np.uint8).tobytes()
        rises = (np.diff(table.astype(np.int16), axis=0) >= 0).all(axis=0) & (np.ptp(table, axis=0) > 0)
        for (kind, order), sent in PLAIN_CELLS.items():
            around = length - rows * columns * CELL_BITS[kind] // 8
            for end in range(length) if 0 < around <= MOST_AROUND else ():
                runs = re.finditer(rb"[^\0]+", steady[end : end + around])
                run = max(runs, key=lambda run: len(run[0]), default=None)
                if run is None:
                    continue
                header = run[0][: SHORT_HEADER if rises[end + run.end()] else LONGEST_HEADER]
                is_rare = data.count(header, -LENGTH_BYTES) <= (1 + STRAY * length) * len(table)
                values = _decoded(table[:, end + around : end + length], sent) if is_rare else None
                if values is not None:
                    place = {"skip": around - run.start() - len(header), "tail": run.start()}
                    grid = {"rows": rows, "columns": columns, "cell": kind, "order": order}
                    described = replace(PadFormat(), full_scale=1, header=header.hex(), **grid, **place)
                    yield Placement(described, values)


def _decoded(cells: NDArray[np.uint8], kind: str) -> Numbers | None:
    """Return (frames, cells) as sent; None for floats of which few have a usual size."""
    with np.errstate(invalid="ignore"):
        sent = np.ascontiguousarray(cells).view(kind).astype(np.float64)
        is_usual = (sent == 0) | ((np.abs(sent) > TINY_FLOAT) & (np.abs(sent) < HUGE_FLOAT))
    return np.where(is_usual, sent, 0) if is_usual.mean() >= STEADY_SHARE else None
