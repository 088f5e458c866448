"""Finds the frames in lines of text, and where a grid's cells may lie among their numbers."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import lt

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.text import ended_at, lines_in, numbers_in
from touchd.drivers.search.neighbours import Numbers, Reading, counting

LEAST_FRAMES = 8
# Numbers of a line beside its cells. Lines in public sketches have up to ten (an IMU); a second pad has more.
MOST_BESIDE = 16
# A framing has to hold for this share of the lines; log lines and damage break some.
MOSTLY = 0.9
FEW = 1 - MOSTLY
# Texts that may end a frame: the most frequent ones.
MOST_ENDS = 3
# Words of the frames change this often only in hexadecimal, or if two boards send by turns.
CHANGING = 0.2
NUMBER = re.compile(
    rb"0[xX][0-9A-Fa-f]+|[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|\*[0-9A-Fa-f]{2}\s*$|\x1b\[\S*?[A-Za-z]"
)
NO_LETTERS = re.compile(rb"[^A-Za-z]+|(?i:nan|null)")
NO_DIGITS = bytes(set(range(256)) - set(b"0123456789"))


@dataclass(frozen=True)
class TextLine:
    """A line's numbers, the number of its label, and its text."""

    numbers: Sequence[float]
    label: int | None
    text: bytes

    @property
    def words(self) -> bytes:
        """The letters beside its numbers."""
        return NO_LETTERS.sub(b"", NUMBER.sub(b"", self.text))


@dataclass(frozen=True, eq=False)
class Printed:
    """Frames of equal lines.

    numbers: (frames, lines, numbers of a line). skip: how many numbers at least lead each line. end: the text
    that ends a frame. changing: the share of frames whose words differ from the last one's.
    """

    numbers: Numbers
    skip: int
    end: str
    changing: float

    @property
    def are_cells(self) -> NDArray[np.bool_]:
        """Which columns of lines may be cells: they change with time, or are equal in all lines."""
        moves = np.ptp(self.numbers, axis=0).max(axis=0)
        differs = np.ptp(self.numbers[0], axis=0)
        moves[: self.skip], differs[: self.skip] = 0, 1
        return np.array((moves > 0) | (differs == 0))


def lines_of(data: bytes) -> list[TextLine]:
    """Return the whole lines of a text."""
    text = data[: ended_at(data)]
    return [TextLine(*numbers_in(line), line) for line in lines_in(text)][1:] if text else []


def printed(lines: Sequence[TextLine]) -> Iterator[Printed]:
    """Yield the frames that the lines may form: each line a frame, and several lines a frame."""
    weight: Counter[int] = Counter()
    for line in lines:
        weight[len(line.numbers)] += len(line.numbers)
    for width, numbers in weight.most_common(1):
        alike = [line for line in lines if len(line.numbers) == width]
        if width == 0 or 2 * numbers < weight.total():
            continue
        if (several := _in_several_lines(lines, width)) is not None:
            yield several
        if len(alike) >= LEAST_FRAMES:
            yield _table([[line] for line in alike], 0, "")


def readings(lines: Sequence[TextLine], rows: int, columns: int) -> Iterator[Reading]:
    """Yield the placements of a grid's cells in the lines."""
    for frames in printed(lines):
        count, height, width = frames.numbers.shape
        across, left = divmod(rows * columns, height)
        beside = width - across
        is_line = width >= rows * columns
        if frames.changing > CHANGING:
            continue
        if (
            left
            or is_line != (height == 1)
            or not 0 <= beside <= MOST_BESIDE
            or not np.isfinite(frames.numbers).all()
        ):
            continue
        counts = counting(frames.numbers.reshape(count, -1)).reshape(height, width).max(axis=0)
        for skip in range(frames.skip, beside + 1):
            cells = np.arange(skip, skip + across)
            leads = frames.numbers[:, :, :skip]
            if counts[cells].any() or (np.diff(leads, axis=1) < 0).any(axis=(1, 2)).mean() > FEW:
                continue
            described = PadFormat(
                framing="text", rows=rows, columns=columns, skip=skip, tail=beside - skip, end=frames.end
            )
            values = frames.numbers[:, :, cells].reshape(count, -1)
            yield Reading(described, values, np.delete(frames.numbers, cells, axis=2).reshape(count, -1))


def _table(frames: Sequence[Sequence[TextLine]], skip: int, end: str) -> Printed:
    words = [tuple(line.words for line in frame) for frame in frames]
    changing = sum(one != other for one, other in pairwise(words)) / max(len(words) - 1, 1)
    return Printed(np.array([[line.numbers for line in frame] for frame in frames]), skip, end, changing)


def _in_several_lines(lines: Sequence[TextLine], width: int) -> Printed | None:
    """Return the frames of lines with `width` numbers, by the first separator that fits."""
    ends = Counter(line.text.strip() for line in lines if len(line.numbers) != width and line.text.strip())
    suffixes = Counter(_after_numbers(line.text) for line in lines if len(line.numbers) == width)
    marks = [text for text, _ in (ends.most_common(MOST_ENDS) + suffixes.most_common(MOST_ENDS)) if text]
    for skip, end in [*((skip, b"") for skip in range(MOST_BESIDE)), *((0, mark) for mark in marks)]:
        if not end.isascii() or not end.decode().isprintable():
            continue
        # The first and the last run may be parts of frames.
        runs = list(_runs(lines, width, skip, end))[1:-1]
        if len(runs) < LEAST_FRAMES:
            continue
        length, times = Counter(map(len, runs)).most_common(1)[0]
        if length > 1 and times * length >= MOSTLY * sum(map(len, runs)):
            return _table([run for run in runs if len(run) == length], skip, end.decode())
    return None


def _runs(lines: Sequence[TextLine], width: int, skip: int, end: bytes) -> Iterator[list[TextLine]]:
    """Yield the lines between two separators, as the parser of such a format takes them."""
    run: list[TextLine] = []
    leads: Sequence[float] = ()
    for line in lines:
        fits = len(line.numbers) == width
        if end:
            run += [line] if fits else []
            if line.text.rstrip().endswith(end):
                yield run
                run = []
            continue
        now = line.numbers[:skip] if line.label is None else [line.label, *line.numbers[:skip]]
        if run and (not fits or any(map(lt, now, leads))):
            yield run
            run = []
        if fits:
            run.append(line)
            leads = now
    if run:
        yield run


def _after_numbers(text: bytes) -> bytes:
    """Return what follows a line's last number."""
    return text[len(text.rstrip(NO_DIGITS)) :].strip()
