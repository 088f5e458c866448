"""Finds the frames in bytes, and where a grid's cells may lie among them.

Frames of one length have a header: bytes that never change, at a constant distance, and are rare elsewhere.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Literal

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from touchd.drivers.pad.binary import CELL_BITS, PLAIN_CELLS, BinaryFrames, frame_bytes
from touchd.drivers.pad.format import CELL_TOP, PadFormat
from touchd.drivers.search.neighbours import Numbers, Reading
from touchd.drivers.search.text import LEAST_FRAMES

Bytes = NDArray[np.uint8]
Order = Literal["little", "big"]

# Bytes of a frame beside its cells: header, length, 64-bit clock, counter and checksum take 20.
MOST_AROUND = 32
LONGEST_HEADER, LEAST_HEADER = 8, 2
# Bytes of a counter beside those that were seen to count: a 64-bit clock has seven.
UPPER_BYTES = 7
# One frame in 65 may be damaged; the proof asks for 98 %.
STEADY_SHARE = 0.985
# A header may also occur among the cells, by chance, as a single byte does among random bytes.
STRAY, STRAY_A_BYTE = 1.5, 0.01
# Where no grid is known, a frame's length is a distance at which n-grams of these sizes recur, so often that
# they cover this share of the bytes; the limits are those of pads.
GRAMS, COVERED = (1, 2, 3, 4), 0.6
LEAST_LENGTH, LONGEST_LENGTH, MOST_LENGTHS = 17, 17_000, 64
LENGTH_BYTES = 400_000
CHECKSUMS = ("values", "sum8", "xor8")
CLOCK_TOLERANCE = 0.1
# Floats of a pad are zero or of a size between these.
TINY_FLOAT, HUGE_FLOAT = 1e-9, 1e9
KINDS: tuple[tuple[str, Order], ...] = (
    ("u8", "little"),
    *((kind, order) for kind in ("u16", "i16", "f32") for order in ("little", "big")),
)


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of one length, (frames, bytes), which begin at an arbitrary byte.

    steady: which bytes never change. marks: which of those mark a frame, because they hardly occur elsewhere.
    """

    data: Bytes
    steady: NDArray[np.bool_]
    marks: NDArray[np.bool_]
    counts: dict[bytes, int] = field(default_factory=dict)

    def tells(self, header: bytes) -> bool:
        """Whether these bytes occur once a frame and hardly ever elsewhere."""
        if header not in self.counts:
            self.counts[header] = self.data.tobytes().count(header)
        return 0 < self.counts[header] <= _stray(self.data.shape[1]) * len(self.data)


def frames_in(data: bytes) -> Frames | None:
    """Return the frames of the likeliest length, where no grid is known."""
    found = (frames_of(data, length) for length in _lengths(data))
    return next((frames for frames in found if frames is not None), None)


def frames_of(data: bytes, length: int) -> Frames | None:
    """Return the frames of a length, if bytes mark them; the first half of the data may be anything."""
    for skipped in (0.0, 0.25, 0.5):
        count = int(len(data) * (1 - skipped)) // length
        if count < LEAST_FRAMES:
            return None
        last = data[len(data) - count * length :]
        table = np.frombuffer(last, np.uint8).reshape(count, length)
        usual = table[count // 2]
        steady = (table == usual).mean(axis=0) >= STEADY_SHARE
        marks = _marks(last, usual, steady, count)
        if marks.any():
            return Frames(table, steady, marks)
    return None


def readings(data: bytes, rows: int, columns: int) -> Iterator[Reading]:
    """Yield the placements of a grid's cells in frames of the lengths that fit."""
    for bits in (8, 16, 32):
        size = rows * columns * bits // 8
        for around in range(1, MOST_AROUND + 1):
            frames = frames_of(data, size + around)
            if frames is not None:
                yield from _placed(frames, around, PadFormat(header="00", rows=rows, columns=columns), bits)


def _placed(frames: Frames, around: int, grid: PadFormat, bits: int) -> Iterator[Reading]:
    """Yield the readings of cells of one size, beginning at each byte that leaves a header beside them."""
    length = frames.data.shape[1]
    twice = np.hstack([frames.data[:-1], frames.data[1:]])
    steps = np.diff(frames.data.astype(np.int16), axis=0)
    only_rise = np.array((steps >= 0).all(axis=0) & (steps > 0).any(axis=0))
    for start in range(length):
        places = np.arange(start - around, start) % length
        header = _header(frames, places, only_rise)
        if header is None:
            continue
        begin, mark = header
        # The cells that follow a header may lie in the next frame of the table.
        cells = twice[:, start : start + length - around]
        beside = twice[:, places].astype(np.float64)
        for kind, order in KINDS:
            if CELL_BITS[kind] == bits and (values := _decoded(cells, kind, order)) is not None:
                described = replace(
                    grid,
                    header=mark.hex(),
                    skip=around - begin - len(mark),
                    tail=begin,
                    cell=kind,
                    order=order,
                    full_scale=CELL_TOP.get(kind, 1),
                )
                yield Reading(described, values, beside)


def _decoded(cells: Bytes, kind: str, order: Order) -> Numbers | None:
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


def _header(
    frames: Frames, places: NDArray[np.int_], only_rise: NDArray[np.bool_]
) -> tuple[int, bytes] | None:
    """Return the header in the bytes around the cells, and where it begins there.

    Bytes next to one that only rises may be the upper bytes of its counter, and change later.
    """
    steady, marks = frames.steady[places], frames.marks[places]
    usual = np.median(frames.data[:, places], axis=0).astype(np.uint8).tobytes()
    best: tuple[int, bytes] | None = None
    edges = np.flatnonzero(np.diff(np.concatenate([[False], steady, [False]]).astype(np.int8)))
    for start, stop in edges.reshape(-1, 2).tolist():
        before = UPPER_BYTES * bool(start and only_rise[places[start - 1]])
        after = UPPER_BYTES * bool(stop < len(usual) and only_rise[places[stop]])
        upper = sorted(product(range(before + 1), range(after + 1)), key=sum, reverse=True)
        tried = [
            (start + one, usual[start + one : max(stop - other, 0)][:LONGEST_HEADER]) for one, other in upper
        ]
        telling = [each for each in tried if frames.tells(each[1])] if marks[start:stop].any() else []
        found = next(
            (each for each in telling if _weight(each[1]) >= LEAST_HEADER), next(iter(telling), None)
        )
        if found and (best is None or _weight(found[1]) > _weight(best[1])):
            best = found
    return best


def _weight(header: bytes) -> int:
    """Return how many bytes of a header are not 0."""
    return len(header) - header.count(0)


def _stray(length: int) -> float:
    """Return how often a header may occur in a frame of this length."""
    return STRAY + STRAY_A_BYTE * length


def _lengths(data: bytes) -> list[int]:
    """Return likely lengths of a frame: distances at which the same bytes recur; multiples come last."""
    part = np.frombuffer(data[-LENGTH_BYTES:], np.uint8).astype(np.uint32)
    found: dict[int, float] = {}
    for size in GRAMS:
        if len(part) < 4 * size:
            break
        codes = sum(part[at : len(part) - size + 1 + at] << np.uint32(8 * at) for at in range(size))
        places = np.argsort(codes, kind="stable")
        distances = np.diff(places)[codes[places][1:] == codes[places][:-1]]
        counts = np.bincount(distances[distances <= LONGEST_LENGTH], minlength=LEAST_LENGTH)
        shares = counts * np.arange(len(counts)) / len(part)
        for length in np.flatnonzero(shares[LEAST_LENGTH:] > COVERED) + LEAST_LENGTH:
            found[int(length)] = max(found.get(int(length), 0.0), float(shares[length]))
    return sorted(sorted(found, key=lambda length: -found[length])[:MOST_LENGTHS])


def _marks(data: bytes, usual: Bytes, steady: NDArray[np.bool_], frames: int) -> NDArray[np.bool_]:
    """Return which steady bytes, alone or with neighbours, occur once a frame and hardly ever elsewhere."""
    marks = np.zeros(len(usual), np.bool_)
    around, length = np.append(usual, usual).tobytes(), len(usual)
    most = _stray(length) * frames
    counts: dict[bytes, int] = {}
    for size in GRAMS:
        windows = [(np.roll(steady, -at), np.roll(marks, -at)) for at in range(size)]
        all_steady, all_marked = np.logical_and.reduce(windows)
        for at in np.flatnonzero(all_steady & ~all_marked).tolist():
            gram = around[at : at + size]
            if gram not in counts:
                counts[gram] = data.count(gram)
            if counts[gram] <= most:
                marks[np.arange(at, at + size) % length] = True
    return marks


def complete(described: PadFormat, data: bytes, times_s: Numbers) -> PadFormat:
    """Return a description with the clock and the checksum that are among the bytes it skips."""
    reader = BinaryFrames(described)
    size, header = frame_bytes(described), described.first_bytes
    starts, at = [], data.find(header)
    while at >= 0 and at + size <= len(data):
        is_frame = data[at + size : at + size + len(header)] == header
        starts += [at] if is_frame else []
        at = data.find(header, at + (size if is_frame else 1))
    if len(starts) < LEAST_FRAMES:
        return described
    windows = [data[at : at + size] for at in starts]
    if described.skip >= 4:
        counts = np.array([reader.time_in(window) for window in windows], dtype=np.int64)
        passed_s = float(times_s[starts[-1]] - times_s[starts[0]])
        steps = np.diff(counts) % 2**32
        is_ms = abs(int(steps.sum()) / max(1000 * passed_s, 1e-9) - 1) < CLOCK_TOLERANCE
        if is_ms and (steps > 0).mean() > STEADY_SHARE:
            described = replace(described, clock=True, skip=described.skip - 4)
    if described.tail != 1 or described.cell == "f32" or len({window[-1] for window in windows}) <= 2:
        return described
    for checksum in CHECKSUMS:
        summed = replace(described, tail=0, checksum=checksum)
        checks = BinaryFrames(summed)
        if np.mean([checks.damage_in(window) is None for window in windows]) > STEADY_SHARE:
            return summed
    return described
