"""Finds the frames in lines of text, and where a grid's cells may lie among their numbers."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import lt

import numpy as np

from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.text import ended_at, lines_in, numbers_in
from touchd.drivers.search.neighbours import Numbers, Placement

# Fewer frames than these, a second of the slowest pad, show no movement.
LEAST_FRAMES = 8
# Numbers of a line beside its cells. Lines in public sketches have up to ten (an IMU); a second pad has more.
MOST_BESIDE = 16
# A framing has to hold for this share of the lines; the log lines of public sketches break one in twenty.
MOSTLY = 0.9
# Texts that may end a frame: the most frequent ones. Sketches print two lines of words a frame at most.
MOST_ENDS = 3
NO_DIGITS = bytes(set(range(256)) - set(b"0123456789"))


@dataclass(frozen=True)
class TextLine:
    """A line's numbers, the number of its label, and its text."""

    numbers: Sequence[float]
    label: int | None
    text: bytes


@dataclass(frozen=True, eq=False)
class Printed:
    """Frames of equal lines.

    numbers: (frames, lines, numbers of a line). skip: how many numbers at least lead each line. end: the text
    that ends a frame.
    """

    numbers: Numbers
    skip: int
    end: str


def lines_of(data: bytes) -> list[TextLine]:
    """Return the whole lines of a text."""
    text = data[: ended_at(data)]
    return [TextLine(*numbers_in(line), line) for line in lines_in(text)][1:] if text else []


def printed(lines: Sequence[TextLine]) -> Iterator[Printed]:
    """Yield the frames that the lines may form: several lines a frame, and each line a frame."""
    weight: Counter[int] = Counter()
    for line in lines:
        weight[len(line.numbers)] += len(line.numbers)
    width, numbers = weight.most_common(1)[0] if weight else (0, 0)
    if width == 0 or 2 * numbers < weight.total():
        return
    if (several := _in_several_lines(lines, width)) is not None:
        yield several
    frames = [[line.numbers] for line in lines if len(line.numbers) == width]
    if len(frames) >= LEAST_FRAMES:
        yield Printed(np.array(frames), 0, "")


def placements(lines: Sequence[TextLine], rows: int, columns: int) -> Iterator[Placement]:
    """Yield the placements of a grid's cells in the lines."""
    for frames in printed(lines):
        count, height, width = frames.numbers.shape
        across, left = divmod(rows * columns, height)
        beside = width - across
        is_line = width >= rows * columns
        if left or is_line != (height == 1) or not 0 <= beside <= MOST_BESIDE:
            continue
        for skip in range(frames.skip, beside + 1):
            described = PadFormat(
                framing="text", rows=rows, columns=columns, skip=skip, tail=beside - skip, end=frames.end
            )
            values = frames.numbers[:, :, skip : skip + across].reshape(count, -1)
            if np.isfinite(values).all():
                yield Placement(described, values)


def _in_several_lines(lines: Sequence[TextLine], width: int) -> Printed | None:
    """Return the frames of lines with `width` numbers, by the first separator that fits."""
    ends = Counter(line.text.strip() for line in lines if len(line.numbers) != width and line.text.strip())
    suffixes = Counter(_after_numbers(line.text) for line in lines if len(line.numbers) == width)
    marks = [text for text, _ in (ends.most_common(MOST_ENDS) + suffixes.most_common(MOST_ENDS)) if text]
    for skip, end in [*((skip, b"") for skip in range(MOST_BESIDE)), *((0, mark) for mark in marks)]:
        if not end.isascii() or not end.decode().isprintable():
            continue
        # The first and the last run may be parts of frames.
        runs = list(filter(None, _runs(lines, width, skip, end)))[1:-1]
        if len(runs) < LEAST_FRAMES:
            continue
        length, times = Counter(map(len, runs)).most_common(1)[0]
        if length > 1 and times * length >= MOSTLY * sum(map(len, runs)):
            frames = [[line.numbers for line in run] for run in runs if len(run) == length]
            return Printed(np.array(frames), skip, end.decode())
    return None


def _runs(lines: Sequence[TextLine], width: int, skip: int, end: bytes) -> Iterator[list[TextLine]]:
    """Yield the lines between two separators, as the parser of such a format takes them."""
    run: list[TextLine] = []
    leads: Sequence[float] = ()
    for line in lines:
        fits = len(line.numbers) == width
        now = line.numbers[:skip] if line.label is None else [line.label, *line.numbers[:skip]]
        if not end and (not fits or any(map(lt, now, leads))):
            yield run
            run = []
        if fits:
            run.append(line)
            leads = now
        if end and line.text.rstrip().endswith(end):
            yield run
            run = []
    yield run


def _after_numbers(text: bytes) -> bytes:
    """Return what follows a line's last number."""
    return text[len(text.rstrip(NO_DIGITS)) :].strip()
