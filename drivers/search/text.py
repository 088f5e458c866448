"""Finds the frames in lines of text, and where a grid's cells may lie among their numbers."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.pad.arrived import is_text
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.text import ended_at, lines_in, numbers_in
from touchd.drivers.search.proof import Cells, Numbers, Placement

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


def lines_of(data: bytes) -> list[TextLine] | None:
    """Return the complete lines; None if the bytes are not text or hold too few lines."""
    lines = list(lines_in(data[: ended_at(data)])) if is_text(data) else []
    return [TextLine(*numbers_in(line), line) for line in lines[1:]] if len(lines) > LEAST_FRAMES else None


def printed(lines: Sequence[TextLine]) -> Iterator[Printed]:
    """Yield the frames that the lines may form: several lines a frame, and each line a frame."""
    widths = Counter(len(line.numbers) for line in lines)
    width = max(widths, key=lambda each: each * widths[each], default=0)
    at = np.flatnonzero([len(line.numbers) == width for line in lines])
    numbers_in_all = sum(each * widths[each] for each in widths)
    if len(at) < LEAST_FRAMES or not 0 < numbers_in_all <= 2 * width * len(at):
        return
    numbers = np.array([lines[each].numbers for each in at.tolist()])
    for skip, end, is_split in _splits(lines, numbers, at):
        # The first and the last lines may be parts of frames.
        begins = np.flatnonzero(is_split) + 1
        lengths = np.diff(begins)
        length = int(np.bincount(lengths).argmax()) if len(lengths) >= LEAST_FRAMES else 1
        whole = begins[:-1][lengths == length]
        if length > 1 and len(whole) * length >= MOSTLY * lengths.sum():
            yield Printed(numbers[whole[:, None] + np.arange(length)], skip, end)
            break
    yield Printed(numbers[:, None], 0, "")


def _splits(
    lines: Sequence[TextLine], numbers: Numbers, at: Cells
) -> Iterator[tuple[int, str, NDArray[np.bool_]]]:
    """Yield what may separate frames: a count of leading numbers, an end, and after which rows it comes.

    numbers: those of each line that may be a row. at: the places of these lines.
    """
    leads = np.column_stack([[lines[each].label or 0 for each in at.tolist()], numbers])
    is_split = np.diff(at) > 1
    for skip in range(min(MOST_BESIDE, numbers.shape[1])):
        is_split = is_split | (np.diff(leads[:, skip]) < 0)
        yield skip, "", is_split
    ends = Counter(filter(None, (_after_numbers(line.text) for line in lines)))
    for end, _ in ends.most_common(MOST_ENDS):
        if end.isascii() and end.decode().isprintable():
            ended = np.cumsum([0, *(line.text.rstrip().endswith(end) for line in lines)])
            yield 0, end.decode(), np.diff(ended[at]) > 0


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
            # Leading numbers number the lines, or stay the same: where they fall, the parser begins a frame.
            falls = (np.diff(frames.numbers[:, :, :skip], axis=1) < 0).sum()
            if np.isfinite(values).all() and falls <= (1 - MOSTLY) * count:
                yield Placement(described, values)


def _after_numbers(text: bytes) -> bytes:
    """Return what follows a line's last number."""
    return text[len(text.rstrip(NO_DIGITS)) :].strip()
