"""Finds the frames in bytes, and where a grid's cells may lie among them.

Frames of one length have a header: bytes that never change, at a constant distance, and are rare elsewhere.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from touchd.drivers.pad.binary import CELL_BITS, PLAIN_CELLS
from touchd.drivers.pad.format import CELL_TOP, PadFormat
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.search.neighbours import Numbers, Reading
from touchd.drivers.search.text import LEAST_FRAMES

Flags = NDArray[np.bool_]
# Bytes of a frame beside its cells: header, length, 64-bit clock, counter and checksum take 20.
MOST_AROUND = 32
LONGEST_HEADER, SHORT_HEADER = 8, 2
# One frame in 65 may be damaged; the proof asks for 98 %.
STEADY_SHARE = 0.985
# A header may also occur among the cells, by chance, as a single byte does among random bytes.
STRAY, STRAY_A_BYTE = 1.5, 0.01
# Where no grid is known, a frame's length is a distance at which n-grams of these sizes recur so often that
# they cover this share of the bytes. Chosen on the presets' streams; the length of the largest pad limits it.
GRAMS, COVERED, LONGEST_LENGTH, LENGTH_BYTES = (1, 2, 3, 4), 0.6, 17_000, 400_000
# A board's clock differs from ours by less.
CLOCK_TOLERANCE = 0.1
# Floats of a pad are zero or of a size between these.
TINY_FLOAT, HUGE_FLOAT = 1e-9, 1e9


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of one length, (frames, bytes), which begin at an arbitrary byte; which bytes never change."""

    data: NDArray[np.uint8]
    steady: Flags
    only_rise: Flags
    counts: dict[bytes, int] = field(default_factory=dict)

    def tells(self, header: bytes) -> bool:
        """Whether these bytes occur once a frame and hardly ever elsewhere."""
        if header not in self.counts:
            self.counts[header] = self.data.tobytes().count(header)
        frames, length = self.data.shape
        return 0 < self.counts[header] <= int((STRAY + STRAY_A_BYTE * length) * frames)

    def header_in(self, places: NDArray[np.int_]) -> tuple[int, bytes]:
        """Return where in these bytes of a frame a header begins, and the header; b"" if there is none.

        Zeros, and bytes next to one that only rises, may be upper bytes of a counter, and change later.
        """
        usual = np.median(self.data[:, places], axis=0).astype(np.uint8).tobytes()
        best = 0, b""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], self.steady[places], [0]])))
        for start, stop in edges.reshape(-1, 2).tolist():
            header = usual[start:stop].strip(b"\0") or usual[start:stop]
            begin = usual.index(header, start)
            if start and self.only_rise[places[start - 1]]:
                begin, header = begin + max(len(header) - SHORT_HEADER, 0), header[-SHORT_HEADER:]
            if stop < len(usual) and self.only_rise[places[stop]]:
                header = header[:SHORT_HEADER]
            if len(header[:LONGEST_HEADER]) > len(best[1]) and self.tells(header[:LONGEST_HEADER]):
                best = begin, header[:LONGEST_HEADER]
        return best


def frames_in(data: bytes) -> Frames | None:
    """Return the frames of the shortest length at which the same bytes recur, where no grid is known."""
    part = np.frombuffer(data[-LENGTH_BYTES:], np.uint8).astype(np.uint32)
    lengths: set[int] = set()
    for size in GRAMS if len(part) > 16 else ():
        codes = sum(part[at : len(part) - size + 1 + at] << np.uint32(8 * at) for at in range(size))
        places = np.argsort(codes, kind="stable")
        distances = np.diff(places)[codes[places][1:] == codes[places][:-1]]
        counts = np.bincount(distances[distances <= LONGEST_LENGTH])
        lengths |= set(np.flatnonzero(counts * np.arange(len(counts)) > COVERED * len(part)).tolist())
    found = (_frames_of(data, length) for length in sorted(lengths) if length > 16)
    return next((frames for frames in found if frames is not None), None)


def _frames_of(data: bytes, length: int) -> Frames | None:
    """Return the frames of a length, if a header marks them; the first half of the data may be anything."""
    for skipped in (0.0, 0.25, 0.5):
        count = int(len(data) * (1 - skipped)) // length
        if count < LEAST_FRAMES:
            return None
        table = np.frombuffer(data[len(data) - count * length :], np.uint8).reshape(count, length)
        steady = (table == table[count // 2]).mean(axis=0) >= STEADY_SHARE
        if not steady.any():
            continue
        steps = np.diff(table.astype(np.int16), axis=0)
        rises = np.logical_and((steps >= 0).all(axis=0), (steps > 0).any(axis=0))
        frames = Frames(table, steady, rises)
        # Begin at a byte that changes, so that no header is cut.
        if frames.header_in(np.roll(np.arange(length), -int(steady.argmin())))[1]:
            return frames
    return None


def readings(data: bytes, rows: int, columns: int) -> Iterator[Reading]:
    """Yield the placements of a grid's cells in frames of the lengths that fit."""
    for bits, around in product((8, 16, 32), range(1, MOST_AROUND + 1)):
        frames = _frames_of(data, rows * columns * bits // 8 + around)
        if frames is not None:
            kinds = [each for each in PLAIN_CELLS if CELL_BITS[each[0]] == bits and each != ("u8", "big")]
            yield from _placed(frames, around, PadFormat(header="00", rows=rows, columns=columns), kinds)


def _placed(frames: Frames, around: int, grid: PadFormat, kinds: list[tuple[str, str]]) -> Iterator[Reading]:
    """Yield the readings of cells that begin at each byte that leaves a header beside them."""
    length = frames.data.shape[1]
    # The cells that follow a header may lie in the next frame of the table.
    twice = np.hstack([frames.data[:-1], frames.data[1:]])
    for start in range(length):
        places = np.arange(start - around, start) % length
        tail, header = frames.header_in(places)
        if not header:
            continue
        described = replace(grid, header=header.hex(), skip=around - tail - len(header), tail=tail)
        for cell, order in kinds:
            values = _decoded(twice[:, start : start + length - around], cell, order)
            if values is not None:
                top = CELL_TOP.get(cell, 1)
                kind = replace(described, cell=cell, order=order, full_scale=top)
                yield Reading(kind, values, twice[:, places].astype(np.float64))


def _decoded(cells: NDArray[np.uint8], kind: str, order: str) -> Numbers | None:
    """Return (frames, cells) as one kind of cell; None if they are unlikely to be such cells."""
    sent: NDArray[Any] = np.ascontiguousarray(cells).view(PLAIN_CELLS[kind, order])
    if kind == "i16" and not (sent < 0).any():
        return None
    if kind == "f32":
        with np.errstate(invalid="ignore"):
            size = np.abs(sent)
        if ((size < HUGE_FLOAT) & ((size == 0) | (size > TINY_FLOAT))).mean() < STEADY_SHARE:
            return None
        sent = np.where(size < HUGE_FLOAT, sent, 0)
    return sent.astype(np.float64)


def complete(described: PadFormat, reading: Reading, data: bytes, seconds: float) -> PadFormat:
    """Return a description with the clock and the checksum that are among the bytes it skips."""
    if described.skip >= 4:
        sent = reading.beside[:, reading.beside.shape[1] - described.skip :][:, :4].astype(np.uint8)
        count = np.ascontiguousarray(sent).view("<u4" if described.order == "little" else ">u4")[:, 0]
        steps = np.remainder(np.diff(count.astype(np.int64)), 2**32)
        is_ms = abs(float(steps.sum()) / (1000 * seconds) - 1) < CLOCK_TOLERANCE
        if is_ms and np.mean(steps > 0) > STEADY_SHARE:
            described = replace(described, clock=True, skip=described.skip - 4)
    is_still = described.tail != 1 or np.ptp(reading.beside[:, 0]) == 0
    for checksum in () if is_still or described.cell == "f32" else ("values", "sum8", "xor8"):
        parser = parser_of(replace(described, tail=0, checksum=checksum))
        parser.feed(data, 0.0)
        if parser.counts.bad_checksum < (1 - STEADY_SHARE) * len(reading.values):
            return parser.format
    return described
