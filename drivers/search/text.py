"""Finds the frames in lines of text, and where a grid's cells may lie among their numbers."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.text import ended_at, lines_in, numbers_in
from touchd.drivers.search.proof import Numbers, Placement

# A second of the slowest pad. Fewer frames show no movement.
LEAST_FRAMES = 8
# Numbers in a line beside its cells. Lines of public sketches have up to ten (an IMU); a second pad has more.
MOST_BESIDE = 16
# Share of the lines that must fit a framing; in public sketches, log lines break one frame in twenty.
MOSTLY = 0.9
# How many of the most frequent line endings are tried as the end of a frame; sketches have two at most.
MOST_ENDS = 3
# The largest share of unprintable characters in text, from damage or another encoding.
FEW_SHARE = 0.02
EXCERPT_CHARACTERS, EXCERPT_BYTES = 60, 24
NO_DIGITS = bytes(set(range(256)) - set(b"0123456789"))
TextLine = tuple[list[float], str]
"""The number of a line's label (0 without one) and its numbers; and what follows them."""


class Printed(NamedTuple):
    """Frames of equal lines (frames, lines, numbers), the numbers before a line's cells, a frame's end."""

    numbers: Numbers
    skip: int
    end: str


def is_text(data: bytes) -> bool:
    """Whether these bytes are printable text; text is never parsed as binary."""
    counts = Counter(data.decode("utf-8", "replace"))
    odd = [each for each in counts if not (each.isprintable() or each in "\t\r\n\x1b") or each == "\ufffd"]
    return bool(data) and sum(counts[each] for each in odd) <= FEW_SHARE * counts.total()


def looks_like(data: bytes) -> str:
    """Describe bytes, with an excerpt: a line of text, or bytes in hex."""
    if not is_text(data):
        return f"bytes that are not text, such as {data[-EXCERPT_BYTES:].hex(' ')}"
    lines = data[-4096:].decode("utf-8", "replace").splitlines()
    line = max(lines[1:-1] or lines, key=len, default="")[:EXCERPT_CHARACTERS]
    shown = "".join(each if each.isprintable() else " " for each in line).strip()
    return f"text, such as {shown!r}"


def lines_of(data: bytes) -> list[TextLine] | None:
    """Return the complete lines; None if the bytes are not text or hold too few lines."""
    found: list[TextLine] = []
    for line in lines_in(data[: ended_at(data)]) if is_text(data) else ():
        numbers, label = numbers_in(line)
        end = line[len(line.rstrip(NO_DIGITS)) :].strip()
        found.append(([label or 0, *numbers], end.decode("utf-8", "replace")))
    # The first line may be a part of one.
    return found[1:] if len(found) > LEAST_FRAMES else None


def printed(lines: Sequence[TextLine]) -> Iterator[Printed]:
    """Yield the frames that the lines may form: several lines a frame first, then each line a frame."""
    widths = Counter(len(leads) for leads, _ in lines)
    width = max(widths, key=lambda each: (each - 1) * widths[each])
    at = np.flatnonzero([len(leads) == width for leads, _ in lines])
    leads = np.array([leads for leads, _ in lines if len(leads) == width])
    if width == 1 or len(at) < LEAST_FRAMES or not np.isfinite(leads).all():
        return
    numbers = leads[:, 1:]
    falls = (np.diff(leads[:, :MOST_BESIDE], axis=0) < 0).T
    ends = Counter(end for _, end in lines if end and end.isprintable())
    for end in ("", *(end for end, _ in ends.most_common(MOST_ENDS))):
        ended = np.cumsum([0, *(after.endswith(end) for _, after in lines)])
        # Without an end text, any other line ends a frame. So does a label or leading number that falls.
        is_split = np.diff(ended[at]) > (0 if end else 1)
        for skip, fall in enumerate(falls):
            is_split = is_split | fall
            if (whole := _whole_frames(is_split)) is not None:
                yield Printed(numbers[whole], skip, end)
    for skip in range(MOST_BESIDE + 1):
        yield Printed(numbers[:, None], skip, "")


def _whole_frames(is_split: NDArray[np.bool_]) -> NDArray[np.intp] | None:
    """Return (frames, lines), the lines of each whole frame; None unless most frames are equally long.

    is_split: whether a frame ends between a line and the next.
    """
    # The first and the last lines may be parts of frames.
    begins = np.flatnonzero(is_split) + 1
    lengths = np.diff(begins)
    length = int(np.bincount(lengths).argmax()) if len(lengths) >= LEAST_FRAMES else 1
    whole = begins[:-1][lengths == length]
    if length == 1 or len(whole) * length < MOSTLY * lengths.sum():
        return None
    lines: NDArray[np.intp] = whole[:, None] + np.arange(length)
    return lines


def placements(lines: Sequence[TextLine], rows: int, columns: int) -> Iterator[Placement]:
    """Yield the placements of a grid's cells in the lines."""
    for numbers, skip, end in printed(lines):
        count, height, width = numbers.shape
        across, left = divmod(rows * columns, height)
        tail = width - skip - across
        if not left and 0 <= tail <= MOST_BESIDE - skip:
            described = PadFormat(framing="text", rows=rows, columns=columns, skip=skip, tail=tail, end=end)
            yield Placement(described, numbers[:, :, skip : skip + across].reshape(count, -1))
