"""What a pad sends, before anybody told its rows and columns: numbers a frame, and what they look like."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from touchd.drivers.frame import MIN_RATE_HZ
from touchd.drivers.pad.format import LONGEST_SIDE, PRESETS, SHORTEST_SIDE, PadFormat
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.search import binary, text
from touchd.drivers.search.listen import Chunk, seconds_of

Grid = tuple[int, int]
SIDES = range(SHORTEST_SIDE, LONGEST_SIDE + 1)
# A preset fits if it reads this share of what came; the proof asks for more.
FITS = 0.9


@dataclass(frozen=True)
class Survey:
    """What a pad sends.

    frame: how large a frame is, in words. rate_hz: frames a second. grid: the rows and columns that frames
    show; None if they do not. likely: those that may be right, and why.
    """

    frame: str
    rate_hz: float
    grid: Grid | None
    likely: tuple[Grid, str] | None


def survey(chunks: Sequence[Chunk]) -> Survey | None:
    """Look at what arrived; None if it has no frames."""
    data, seconds = b"".join(chunk.data for chunk in chunks), seconds_of(chunks)
    lines = text.lines_of(data)
    if lines is None:
        table = next(binary.tables(data), None)
        if table is None:
            return None
        length = table.shape[1] // 2
        left = range(length - 1, max(length - binary.MOST_AROUND, 0), -1)
        sizes = [size // cell for size in left for cell in (1, 2, 4)]
        return _shown(f"{length} bytes a frame", len(data) / length / seconds, data, sizes)
    # Log lines among frames of one line look like separators.
    found = text.printed(lines)
    usual = max(found, key=lambda each: len(each.numbers) >= MIN_RATE_HZ * seconds, default=None)
    if usual is None:
        return None
    count, height, width = usual.numbers.shape
    # A column of numbers that never change, but differ from line to line, numbers the rows.
    is_still, differs = np.ptp(usual.numbers, axis=0).max(axis=0) == 0, np.ptp(usual.numbers[0], axis=0) > 0
    beside = binary.counting(usual.numbers).all(axis=0) | (is_still & differs)
    shown = height, width - int(beside.sum())
    frame, rate_hz = f"{height * width} numbers a frame", count / seconds
    if not all(side in SIDES for side in shown):
        return _shown(frame, rate_hz, data, [math.prod(shown)])
    return Survey(frame, rate_hz, shown, (shown, "as its lines show"))


def _shown(frame: str, rate_hz: float, data: bytes, cells: Sequence[int]) -> Survey:
    """Return a survey with the grid of the preset that reads the data, or the squarest grid that fits."""
    preset = next((name for name, each in PRESETS.items() if reads(each, data)), None)
    if preset:
        grid = PRESETS[preset].rows, PRESETS[preset].columns
        return Survey(frame, rate_hz, grid, (grid, f"as {preset}"))
    sides = ((rows, count // rows) for count in cells for rows in SIDES if count % rows == 0)
    grids = (each for each in sides if each[0] <= each[1] and each[1] in SIDES)
    squarest = min(grids, key=lambda grid: grid[1] / grid[0], default=None)
    return Survey(frame, rate_hz, None, squarest and (squarest, "the squarest"))


def reads(preset: PadFormat, data: bytes) -> bool:
    """Whether the parser of a preset reads nearly all of the data."""
    if preset.poll:
        return False
    parser = parser_of(preset)
    parser.feed(data, 0.0)
    counts = parser.counts
    frames = counts.frames + counts.duplicates + counts.bad_time
    return frames >= text.LEAST_FRAMES and frames > FITS * (frames + counts.bad - counts.bad_time)
