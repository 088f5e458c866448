"""Finds the description of a pad in its bytes, told its rows and columns, and proves it.

Told the grid, arithmetic leaves a few placements of the cells in a frame. The one in which neighbours move
together most is proposed if a hand presses the pad and touchd's own parser reads nearly all that came.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from touchd.drivers.frame import MIN_RATE_HZ
from touchd.drivers.pad.arrived import has_text, looks_like
from touchd.drivers.pad.format import PRESETS, PadFormat, as_yaml, layout_of
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.search import binary, text
from touchd.drivers.search.listen import MOST_BYTES, Chunk, seconds_of
from touchd.drivers.search.proof import (
    Numbers,
    Placement,
    is_turned,
    movement,
    objection,
    pairs,
    scaled,
    thinned,
    together,
)
from touchd.drivers.search.survey import Grid, Survey, reads, survey

# How much roughness counts against moving together, as an exponent. The wrong byte order is rougher by up to
# 256, a checksum among the cells by a third; one slow number of a frame makes them smoother by a hundredth.
ROUGHNESS = 0.1
PRINT_FRAMES = "print each frame in a line, or a row a line and an empty line after each frame"
NO_FRAMES_IN_BYTES = "no frames of one length: a wrong baud rate, or no header? send a header of two bytes"
# The parser has to read this share of what came, as docs/pads.md promises, and this share of the later frames
# that were found: a header of one byte that also occurs in the pad's longer header shifts all cells.
EXPLAINED, MOSTLY = 0.98, 0.9
# The fastest rate of a format, and 5 % for the error of one that is measured over seconds.
FASTEST_HZ = 525.0
# The parser may hold frames back for a second and a half, until it knows what their clock counts.
UNTIL_DATED = 0.25
# Frames of a pad do not pause for longer; the third study's do not, with their gaps.
LONGEST_PAUSE_S = 1.5


@dataclass(frozen=True)
class Finding:
    """What a search found.

    proposed: the description, if it is proven. missing: why nothing is proposed, "" if something is. saw:
    what arrived, in words. likely: a description that may be right. may_come: more presses may prove it.
    """

    proposed: PadFormat | None
    missing: str
    saw: str
    likely: PadFormat | None = None
    may_come: bool = False

    def __str__(self) -> str:
        return "; ".join(part for part in (self.saw, self.advice) if part)

    @property
    def advice(self) -> str:
        """What it may be, and what is missing."""
        likely = self.likely and self.missing and f"perhaps {as_yaml(self.likely)}"
        return "; ".join(part for part in (likely, self.missing) if part)


def search(chunks: Sequence[Chunk], grid: Grid | None) -> Finding:
    """Search for the description of a pad in its bytes. grid: its rows and columns, if somebody told them."""
    sizes = np.cumsum([len(chunk.data) for chunk in chunks[::-1]])
    chunks = chunks[len(chunks) - int(np.searchsorted(sizes, MOST_BYTES, "right")) :]
    data = b"".join(chunk.data for chunk in chunks)
    if not data:
        return Finding(None, "is it the pad's port, and does the pad run?", "nothing arrives")
    saw = f"{len(data) / seconds_of(chunks):.0f} bytes/s of {looks_like(data)}"
    lines, is_told = text.lines_of(data), grid is not None
    seen = None if is_told else survey(chunks)
    grid = grid or (seen.grid if seen else None)
    best = _best(data, lines, grid) if grid else None
    if grid is None or best is None:
        seen = survey(chunks) if is_told else seen
        return Finding(None, _why_none_fits(data, lines is not None, seen, grid), saw)
    if is_turned(best):
        turned = msgspec.structs.replace(best.described, rows=grid[1], columns=grid[0])
        best = replace(best, described=turned)
    best = replace(best, described=scaled(best))
    if missing := objection(best):
        return Finding(None, missing, saw, best.described, may_come=True)
    described = _completed(best.described, chunks)
    missing = _unexplained(best, described, chunks)
    return Finding(None if missing else described, missing, saw, described)


def _best(data: bytes, lines: Sequence[text.TextLine] | None, grid: Grid) -> Placement | None:
    """Return the placement in which neighbours move together most, smoothly."""
    placed = binary.placements(data, *grid) if lines is None else text.placements(lines, *grid)
    return max((each for each in placed if not binary.counting(each.values).any()), key=_fit, default=None)


def _fit(placed: Placement) -> tuple[float, float]:
    """Return how much neighbours move together, relative to their roughness; and how evenly cells rest.

    Placements fit as well around a border that never changes; a header there rests at another value.
    """
    steps = np.abs(np.diff(thinned(placed.values), axis=0)).mean(axis=0)
    roughness = max(float(steps.sum()) / max(int((steps > 0).sum()), 1), 1e-9)
    fit = together(movement(placed.values), *pairs(placed.cells)) / roughness**ROUGHNESS
    return round(fit, 4), -float(np.ptp(np.median(placed.values, axis=0)))


def _why_none_fits(data: bytes, is_printed: bool, seen: Survey | None, grid: Grid | None) -> str:
    if not data.strip() or has_text(data):
        return "print lines of numbers and nothing else"
    if seen is None:
        return f"no frames: {PRINT_FRAMES}" if is_printed else NO_FRAMES_IN_BYTES
    if grid is None:
        return f"{seen.frame}; say --grid ROWSxCOLUMNS"
    unfit = f"{seen.frame}, which do not fit {grid[0]}x{grid[1]} cells; say another --grid"
    return f"{unfit}, or {PRINT_FRAMES}" if is_printed else unfit


def _completed(described: PadFormat, chunks: Sequence[Chunk]) -> PadFormat:
    """Return a description with the clock and the checksum beside its cells, or a preset that says more."""
    more = [each for each in PRESETS.values() if _reading_of(each) == _reading_of(described)]
    if described.framing == "binary" and described.skip >= 4:
        clocked = msgspec.structs.replace(described, clock=True, skip=described.skip - 4)
        parser = parser_of(clocked)
        for chunk in chunks:
            parser.feed(*chunk)
        described = clocked if parser.clock.dates_frames else described
    if described.framing == "binary" and described.tail == 1:
        kinds = ("values", "sum8", "xor8")
        more += [msgspec.structs.replace(described, tail=0, checksum=kind) for kind in kinds]
    data = b"".join(chunk.data for chunk in chunks)
    return next((each for each in more if reads(each, data)), described)


def _reading_of(described: PadFormat) -> tuple[object, ...]:
    """Return the grid of a description and what its values mean."""
    grid = (described.framing, described.rows, described.columns)
    return (*grid, described.full_scale, described.invert)


def _unexplained(placed: Placement, described: PadFormat, chunks: Sequence[Chunk]) -> str:
    """Say what a description leaves unexplained when the daemon's own parser reads all that arrived."""
    parser, layout = parser_of(described), layout_of(described)
    frames = [frame for chunk in chunks for frame in parser.feed(*chunk)]
    read = {frame.pressure.tobytes() for frame in frames}
    # At first, a number that is taken for a clock may hold frames back.
    later = np.clip(placed.values[len(placed.values) // 2 :], 0, described.full_scale)
    if np.mean([layout.pressure(each).tobytes() in read for each in later]) < MOSTLY:
        return "touchd's parser reads other cells: is its header among them, or a first number that jumps?"
    counts = parser.counts
    explained = 1 - (counts.bad - counts.bad_time - 1) / len(placed.values)
    if explained < EXPLAINED:
        return f"that explains {100 * explained:.0f} % of what came, not {100 * EXPLAINED:.0f} %"
    return _uneven(np.array([frame.host_s for frame in frames]), chunks[0].host_s, chunks[-1].host_s)


def _uneven(came_s: Numbers, first_s: float, last_s: float) -> str:
    """Say why frames do not come at a pad's rate, once their clock is known."""
    first_s += UNTIL_DATED * (last_s - first_s)
    came_s = came_s[came_s >= first_s]
    gaps_s = np.diff(came_s)
    rate_hz = len(gaps_s) / max(float(gaps_s.sum()), 1e-3)
    if not MIN_RATE_HZ <= rate_hz <= FASTEST_HZ:
        return f"{rate_hz:.1f} frames/s come; {MIN_RATE_HZ:g} to 500 are needed"
    if np.diff(came_s, prepend=first_s, append=last_s).max() > LONGEST_PAUSE_S:
        return "frames do not come at a steady rate, or only while the pad is pressed"
    return ""
