"""Guesses the grids that the bytes of binary frames may form.

Frames of one length have a header: at least one byte that never changes, at a constant distance. Neighbours
that move together show where the cells begin, of which type they are and which grid they form.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any, Literal

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from touchd.drivers.pad.binary import CELL_BITS, PLAIN_CELLS, U12_BITS, BinaryFrames, frame_bytes
from touchd.drivers.pad.format import CELL_TOP, PadFormat
from touchd.drivers.search.coupling import Movement, Numbers, sides
from touchd.drivers.search.text import LEAST_FRAMES, Guess

Bytes = NDArray[np.uint8]
Order = Literal["little", "big"]

LONGEST_FRAME = 17_000
LEAST_CELLS = 16
# Most bytes of a frame besides its cells.
MOST_AROUND = 32
LONGEST_HEADER, LEAST_HEADER = 8, 2
# Most upper bytes of a counter that may stay the same while a search listens.
UPPER_BYTES = 3
GRAMS = (1, 2, 3, 4)
# A distance is a frame's length if this share of the bytes lies between equal n-grams that far apart.
COVERED = 0.6
MOST_ANCHORS = 3
MOST_LENGTHS = 64
STEADY_SHARE = 0.985
# Number of bytes in which a frame's length is searched for.
LENGTH_BYTES = 400_000
# A header may also occur among the cells, by chance, as a single byte does among random bytes.
STRAY, STRAY_A_BYTE = 1.5, 0.01
# Number of frames that are searched for replaced zeros.
COBS_FRAMES = 200
CHECKSUMS = ("values", "sum8", "xor8")
ORDERS: tuple[Order, ...] = ("little", "big")
CLOCK_TOLERANCE = 0.1
# The upper part of a cell changes at most this many times as often as its lower byte.
BUSIER = 0.9
# Floats of a pad are zero or of a size between these.
TINY_FLOAT, HUGE_FLOAT = 1e-9, 1e9
# In a grid, a number shares at least this part of its movement with the next one.
LEAST_LAG = 0.05
# Bytes are signed if, read as such, they change by less than this share.
SIGNED_SHARE = 0.5
# A byte that wraps changes by more than this at once.
WRAP = 192
# If the halves of a byte move the same way this often, they are two cells.
SAME_WAY = 0.7
KINDS: tuple[tuple[str, Order], ...] = (
    ("u8", "little"),
    *((kind, order) for kind in ("u16", "i16", "u12", "f32") for order in ORDERS),
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
    headers: dict[tuple[int, int], tuple[int, bytes]] = field(default_factory=dict)

    @cached_property
    def _bytes(self) -> bytes:
        return self.data.tobytes()

    @cached_property
    def usual(self) -> Bytes:
        usual: Bytes = np.median(self.data, axis=0).astype(np.uint8)
        return usual

    @cached_property
    def _only_rise(self) -> NDArray[np.bool_]:
        steps = np.diff(self.data.astype(np.int16), axis=0)
        return np.logical_and((steps >= 0).all(axis=0), (steps > 0).any(axis=0))

    def tells(self, header: bytes) -> bool:
        """Whether these bytes occur once a frame and hardly ever elsewhere."""
        if not header:
            return False
        if header not in self.counts:
            self.counts[header] = self._bytes.count(header)
        return self.counts[header] <= _stray(self.length) * len(self.data)

    def header_in(self, start: int, around: int) -> tuple[int, bytes]:
        """Find the header in the `around` bytes from `start` on; return its offset and bytes, b"" if none."""
        if (start, around) not in self.headers:
            places = np.arange(start, start + around) % self.length
            usual = self.usual[places].tobytes()
            headers = _headers(usual, self.steady[places], self.marks[places], self._only_rise[places])
            self.headers[start, around] = next((each for each in headers if self.tells(each[1])), (0, b""))
        return self.headers[start, around]

    @property
    def length(self) -> int:
        return int(self.data.shape[1])


def guesses(data: bytes) -> Iterator[Guess]:
    """Yield the grids that binary frames may form."""
    tried: list[int] = []
    for length in _lengths(data):
        # A multiple of a frame's length adds nothing.
        if any(length % shorter == 0 for shorter in tried):
            continue
        frames = _frames_of(data, length)
        if frames is not None:
            tried.append(length)
            found = False
            for guess in _of_length(frames):
                found = True
                yield guess
            if found:
                return


def has_frames(data: bytes) -> bool:
    """Whether there are frames of one length, marked by bytes that never change."""
    return any(_frames_of(data, length) is not None for length in _lengths(data))


def is_cobs(data: bytes) -> bool:
    """Whether zeros end frames in which other zeros are replaced by the distance to the next one (COBS)."""
    frames = data.split(b"\0")[1:-1][-COBS_FRAMES:]
    found = [_distances(frame) for frame in frames]
    right = [each for each in found if each]
    # Frames that all have the same distances may as well be plain ones.
    return len(frames) >= LEAST_FRAMES and len(right) >= STEADY_SHARE * len(frames) and len(set(right)) > 1


def _distances(frame: bytes) -> tuple[int, ...]:
    """Return the distances from each replaced zero to the next one; none if they do not fill the frame."""
    steps: list[int] = []
    at = 0
    while at < len(frame):
        steps.append(frame[at])
        at += frame[at]
    return tuple(steps) if at == len(frame) >= LEAST_CELLS else ()


def _lengths(data: bytes) -> list[int]:
    """Return likely lengths of a frame: distances at which the same bytes recur."""
    part = np.frombuffer(data[-LENGTH_BYTES:], np.uint8).astype(np.uint32)
    found: dict[int, float] = {}
    for size in GRAMS:
        if len(part) < 4 * size:
            break
        codes = sum(part[at : len(part) - size + 1 + at] << np.uint32(8 * at) for at in range(size))
        places = np.argsort(codes, kind="stable")
        again = codes[places][1:] == codes[places][:-1]
        distances = np.diff(places)[again]
        counts = np.bincount(distances[distances <= LONGEST_FRAME], minlength=1)
        for length in np.flatnonzero(
            counts[LEAST_CELLS:] * np.arange(LEAST_CELLS, len(counts)) > COVERED * len(part)
        ):
            at = int(length) + LEAST_CELLS
            found[at] = max(found.get(at, 0.0), counts[at] * at / len(part))
    # Sort them, so that a frame's length comes before its multiples.
    return sorted(sorted(found, key=lambda length: -found[length])[:MOST_LENGTHS])


def _frames_of(data: bytes, length: int) -> Frames | None:
    """Return the frames of a length, if bytes mark them; the first half of the data may be anything."""
    for skipped in (0.0, 0.25, 0.5):
        first = int(skipped * len(data))
        count = (len(data) - first) // length
        if count < LEAST_FRAMES:
            return None
        first = len(data) - count * length
        table = np.frombuffer(data[first:], np.uint8).reshape(count, length)
        usual = table[count // 2]
        steady = (table == usual).mean(axis=0) >= STEADY_SHARE
        marks = _marks(data[first:], usual, steady, count)
        if marks.any():
            return Frames(table, steady, marks)
    return None


def _marks(data: bytes, usual: Bytes, steady: NDArray[np.bool_], frames: int) -> NDArray[np.bool_]:
    """Return which steady bytes, alone or with neighbours, occur once a frame and hardly ever elsewhere."""
    marks = np.zeros(len(usual), np.bool_)
    around, length = np.append(usual, usual).tobytes(), len(usual)
    counts: dict[bytes, int] = {}
    for size in GRAMS:
        windows = [(np.roll(steady, -at), np.roll(marks, -at)) for at in range(size)]
        all_steady, all_marked = np.logical_and.reduce(windows)
        for at in np.flatnonzero(all_steady & ~all_marked).tolist():
            gram = around[at : at + size]
            if gram not in counts:
                counts[gram] = data.count(gram)
            if counts[gram] <= _stray(length) * frames:
                marks[np.arange(at, at + size) % length] = True
    return marks


def _stray(length: int) -> float:
    """Return how often a header may occur in a frame of this length."""
    return STRAY + STRAY_A_BYTE * length


def _of_length(frames: Frames) -> Iterator[Guess]:
    for anchor, run in _anchors(frames)[:MOST_ANCHORS]:
        # The cells may begin and end among the steady bytes.
        more = min(run, MOST_AROUND)
        begun = np.hstack([frames.data[:-1, anchor:], frames.data[1:, :anchor]])
        table = np.hstack([begun[:-1], begun[1:, :more]])
        for kind, order in KINDS:
            bits = CELL_BITS[kind]
            for offset in range({8: 1, 12: 3, 16: 2, 32: 4}[bits]):
                numbers = _decoded(table[:, offset:], kind, order)
                if numbers is not None:
                    yield from _of_kind(frames, numbers, (kind, order), (anchor, run, offset))


def _of_kind(
    frames: Frames, numbers: Numbers, kind: tuple[str, Order], place: tuple[int, int, int]
) -> Iterator[Guess]:
    """Yield the grids of one kind of cell. place: where the table and its numbers begin in a frame."""
    anchor, run, offset = place
    movement = Movement(numbers)
    if not movement.is_pressed or movement.lags[1] < LEAST_LAG:
        return
    bits, length = CELL_BITS[kind[0]], frames.length
    fields: dict[str, Any] = {"cell": kind[0], "order": kind[1] if bits > 8 else "little"}
    for around in range(1, min(MOST_AROUND, length - 1) + 1):
        # An odd number of packed cells ends with half a byte.
        if (length - around) * 8 % bits not in ((0, 4) if bits == 12 else (0,)):
            continue
        cells = (length - around) * 8 // bits
        for rows, columns in sides(cells):
            for start in range(offset, around + run, -(-bits // 8) if bits != 12 else 3):
                at = (start - offset) * 8 // bits
                if at + cells > numbers.shape[1] or movement.counters[at : at + cells].any():
                    continue
                if kind[0] == "i16" and numbers[:, at : at + cells].min() >= 0:
                    continue
                fold = movement.fold(at, rows, columns)
                if fold.score < LEAST_LAG:
                    continue
                begin = (anchor + start) % length
                described = _described(frames, begin, around, fields | {"rows": rows, "columns": columns})
                if described is not None:
                    values = numbers[:, at : at + cells]
                    misfits, is_cut = movement.misfits(at, rows, columns), movement.is_cut(at, cells)
                    is_folded = movement.is_stride(columns)
                    beside = numbers[:, max(at - columns, 0) : at], numbers[:, at + cells :][:, :columns]
                    # Zeros may be a dead row; other bytes that never change are not.
                    is_short = any(each.shape[1] == columns and not each.any() for each in beside)
                    yield Guess(described, values, fold, misfits, is_cut, is_folded, is_short)


def _anchors(frames: Frames) -> list[tuple[int, int]]:
    """Return the first byte and the length of each run of marks; runs may wrap around.

    Those with most bytes other than 0 come first: a cell that is dead is a run of zeros.
    """
    marks, length = frames.marks, frames.length
    if marks.all():
        return [(0, length)]
    turn = int(np.argmin(marks))
    rolled = np.concatenate([[False], np.roll(marks, -turn), [False]]).astype(np.int8)
    edges = np.flatnonzero(np.diff(rolled)).reshape(-1, 2).tolist()
    runs = [((start + turn) % length, stop - start) for start, stop in edges]
    filled = np.append(frames.usual, frames.usual) != 0
    return sorted(runs, key=lambda run: (-filled[run[0] : sum(run)].sum(), -run[1]))


def _decoded(table: Bytes, kind: str, order: Order) -> Numbers | None:
    """Return (frames, numbers) as one kind of cell; None if they are unlikely to be such cells."""
    bits = CELL_BITS[kind]
    width = table.shape[1] * 8 // bits
    if kind == "u12":
        used = table[:, : -(-width * 12 // 8)]
        loose = np.unpackbits(used, axis=1, bitorder=order)[:, : width * 12]
        placed = loose.reshape(len(table), width, 12).astype(np.uint16) << U12_BITS[order]
        packed = placed.sum(axis=2, dtype=np.uint16)
        # Check each of four positions separately: if 16-bit cells are read as packed ones, these differ.
        return (
            packed.astype(np.float64) if all(_lower_is_busier(packed[:, at::4]) for at in range(4)) else None
        )
    used = np.ascontiguousarray(table[:, : width * bits // 8])
    sent = used.view(PLAIN_CELLS[kind, order])
    if kind == "f32":
        with np.errstate(invalid="ignore"):
            size = np.abs(sent)
        usual = ((size < HUGE_FLOAT) & ((size == 0) | (size > TINY_FLOAT))).mean(axis=0) >= STEADY_SHARE
        return np.where(usual, sent, 0).astype(np.float64) if usual.mean() > 0.5 else None
    if kind == "i16" and not (sent < 0).any():
        return None
    if bits == 16 and not _lower_is_busier(used.view(PLAIN_CELLS["u16", order])):
        return None
    return sent.astype(np.float64)


def _lower_is_busier(sent: NDArray[Any]) -> bool:
    """Whether the lower byte changes more often than the rest, as in a cell read in its own order."""
    changed = sent[1:] ^ sent[:-1]
    return bool(BUSIER * np.count_nonzero(changed & 0xFF) >= np.count_nonzero(changed >> 8))


def _described(frames: Frames, start: int, around: int, fields: dict[str, Any]) -> PadFormat | None:
    """Return the description of cells that begin at a byte of the table, with what surrounds them."""
    first, header = frames.header_in((start - around) % frames.length, around)
    if not header:
        return None
    skip, tail = around - first - len(header), first
    top = CELL_TOP.get(fields["cell"], 1)
    return PadFormat(header=header.hex(), skip=skip, tail=tail, full_scale=top, **fields)


def _headers(
    usual: bytes, steady: NDArray[np.bool_], marks: NDArray[np.bool_], only_rise: NDArray[np.bool_]
) -> Iterator[tuple[int, bytes]]:
    """Yield the headers that bytes around cells may hold, and where each begins.

    Bytes next to one that only rises may be the upper bytes of its counter, and change later.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], steady, [False]]).astype(np.int8)))
    for start, stop in edges.reshape(-1, 2).tolist():
        if not marks[start:stop].any():
            continue
        first = start + int(np.argmax(marks[start:stop]))
        before = range(1 + UPPER_BYTES * bool(start > 0 and only_rise[start - 1]))
        after = range(1 + UPPER_BYTES * bool(stop < len(usual) and only_rise[stop]))
        for upper in sorted(product(before, after), key=sum, reverse=True):
            begin, end = max(first, start + upper[0]), stop - upper[1]
            header = usual[begin:end]
            if len(header) - header.count(0) >= LEAST_HEADER:
                yield begin, header[:LONGEST_HEADER]
        yield first, usual[first:stop][:LONGEST_HEADER]


def unlike_bytes(values: Numbers) -> str:
    """Say why one-byte cells (frames, cells) are not readings of one byte each; "" if they may be."""
    steps = np.diff(values, axis=0)
    signed = np.diff((values + 128) % 256, axis=0)
    if np.abs(signed).sum() < SIGNED_SHARE * np.abs(steps).sum():
        return "its bytes seem to be signed; touchd reads unsigned bytes only: send 0 to 255"
    # Before and after a wrap, a number moves against the jump.
    before, jumps, after = steps[:-2], steps[1:-1], steps[2:]
    jump = np.abs(jumps) > WRAP
    wraps = jump & (before * jumps < 0) & (after * jumps < 0)
    if jump.sum() >= LEAST_FRAMES and wraps.sum() > jump.sum() / 2:
        return "its bytes seem to be the lower halves of larger numbers: send both bytes of a cell together"
    upper, lower = np.divmod(values, 16)
    moves = np.diff(upper, axis=0) * np.diff(lower, axis=0)
    # At either end of the range, the halves of a true reading do move the same way: leave these out.
    inside = (np.minimum(upper[1:], upper[:-1]) > 0) & (np.maximum(upper[1:], upper[:-1]) < 15) & (moves != 0)
    if inside.sum() >= LEAST_FRAMES and (moves[inside] > 0).mean() > SAME_WAY:
        return "its bytes seem to hold two cells each: send a byte for each cell"
    return ""


def complete(described: PadFormat, data: bytes, times_s: Numbers) -> PadFormat:
    """Return a description with the clock and the checksum that are among the bytes it skips."""
    reader = BinaryFrames(described)
    size, header = frame_bytes(described), described.first_bytes
    starts, at = [], data.find(header)
    while at >= 0 and at + size <= len(data):
        if data[at + size : at + size + len(header)] == header:
            starts.append(at)
            at = data.find(header, at + size)
        else:
            at = data.find(header, at + 1)
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
    if described.tail == 1 and described.cell != "f32":
        for checksum in CHECKSUMS:
            summed = replace(described, tail=0, checksum=checksum)
            checks = BinaryFrames(summed)
            right = [checks.damage_in(window) is None for window in windows]
            varied = len({window[-1] for window in windows}) > 2
            if varied and np.mean(right) > STEADY_SHARE:
                return summed
    return described
