"""Finds the description of a pad in its bytes, told its rows and columns, and proves it.

Told the grid, arithmetic leaves a few placements of the cells in a frame. The one in which neighbours move
together most is proposed if a hand presses the pad and touchd's own parser reads nearly all that came.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from touchd.drivers.pad.arrived import has_text, is_text, looks_like
from touchd.drivers.pad.format import PRESETS, PadFormat
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.search import binary, text
from touchd.drivers.search.listen import MOST_BYTES, Chunk
from touchd.drivers.search.neighbours import Placement, is_turned, movement, thinned, together
from touchd.drivers.search.proof import objection, scaled, unexplained
from touchd.drivers.search.survey import Grid, Survey, reads, survey

# How much roughness counts against moving together, as an exponent. The wrong byte order is rougher by up to
# 256, a checksum among the cells by a third; one slow number of a frame makes them smoother by a hundredth.
ROUGHNESS = 0.1
PRINT_FRAMES = "print each frame in a line, or a row a line and an empty line after each frame"
NO_FRAMES_IN_BYTES = "no frames of one length: a wrong baud rate, or no header? send a header of two bytes"


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


@dataclass(frozen=True)
class Arrived:
    """The bytes that arrived, in chunks and together, and the lines of a text; None if it is no text."""

    chunks: Sequence[Chunk]
    data: bytes
    lines: Sequence[text.TextLine] | None

    @property
    def seconds(self) -> float:
        return max(self.chunks[-1].host_s - self.chunks[0].host_s, 1e-3)

    @property
    def survey(self) -> Survey | None:
        return survey(self.data, self.lines, self.seconds)


def arrived_in(chunks: Sequence[Chunk]) -> Arrived:
    """Return what arrived, the latest MOST_BYTES."""
    first, size = len(chunks), 0
    while first and size + len(chunks[first - 1].data) <= MOST_BYTES:
        first -= 1
        size += len(chunks[first].data)
    data = b"".join(chunk.data for chunk in chunks[first:])
    is_printed = is_text(data) and len(data.splitlines()) > text.LEAST_FRAMES
    return Arrived(chunks[first:], data, text.lines_of(data) if is_printed else None)


def search(chunks: Sequence[Chunk], grid: Grid | None) -> Finding:
    """Search for the description of a pad in its bytes. grid: its rows and columns, if somebody told them."""
    arrived = arrived_in(chunks)
    data = arrived.data
    if not data:
        return Finding(None, "is it the pad's port, and does the pad run?", "nothing arrives")
    saw = f"{len(data) / arrived.seconds:.0f} bytes/s of {looks_like(data)}"
    seen = arrived.survey
    grid = grid or (seen.grid if seen else None)
    best = _best(_placements(arrived, grid)) if grid else None
    return (
        Finding(None, _why_none_fits(arrived, seen, grid), saw)
        if best is None
        else _proven(best, arrived, saw)
    )


def _placements(arrived: Arrived, grid: Grid) -> Iterator[Placement]:
    """Yield where the cells of a grid may lie in the frames."""
    if arrived.lines is None:
        return binary.placements(arrived.data, *grid)
    return text.placements(arrived.lines, *grid)


def _best(placements: Iterable[Placement]) -> Placement | None:
    """Return the placement in which neighbours move together most, smoothly."""
    rated = (_rated(each) for each in placements if not binary.counting(each.values).any())
    return max(rated, key=lambda each: each[1:], default=(None,))[0]


def _rated(placed: Placement) -> tuple[Placement, float, float]:
    """Return a placement, turned if need be, and how much its neighbours move together, for its roughness.

    If both fit as well, as around a border that never changes, take the cells that rest at the same value.
    """
    moved = movement(placed.values)
    if is_turned(moved, placed.cells):
        rows, columns = placed.described.columns, placed.described.rows
        described = msgspec.structs.replace(placed.described, rows=rows, columns=columns)
        placed = replace(placed, described=described)
    steps = np.abs(np.diff(thinned(placed.values), axis=0)).mean(axis=0)
    roughness = max(float(steps.sum()) / max(int((steps > 0).sum()), 1), 1e-9)
    score = together(moved, placed.cells) / roughness**ROUGHNESS
    return placed, round(score, 4), -float(np.ptp(np.median(placed.values, axis=0)))


def _why_none_fits(arrived: Arrived, seen: Survey | None, grid: Grid | None) -> str:
    if not arrived.data.strip() or has_text(arrived.data):
        return "print lines of numbers and nothing else"
    if seen is None:
        return NO_FRAMES_IN_BYTES if arrived.lines is None else f"no frames: {PRINT_FRAMES}"
    if grid is None:
        return f"{seen.frame}; say --grid ROWSxCOLUMNS"
    unfit = f"{seen.frame}, which do not fit {grid[0]}x{grid[1]} cells; say another --grid"
    return unfit if arrived.lines is None else f"{unfit}, or {PRINT_FRAMES}"


def _proven(best: Placement, arrived: Arrived, saw: str) -> Finding:
    """Return the description of a placement, with its proof or what the proof is missing."""
    described = scaled(best)
    if missing := objection(replace(best, described=described)):
        return Finding(None, missing, saw, described, may_come=True)
    described = _completed(described, arrived)
    if missing := unexplained(described, best.values, arrived.chunks):
        return Finding(None, missing, saw, described)
    return Finding(described, "", saw, described)


def _completed(described: PadFormat, arrived: Arrived) -> PadFormat:
    """Return a description with the clock and the checksum beside its cells, or a preset that says more."""
    more = [each for each in PRESETS.values() if _reading_of(each) == _reading_of(described)]
    if described.framing == "binary" and described.skip >= 4:
        clocked = msgspec.structs.replace(described, clock=True, skip=described.skip - 4)
        parser = parser_of(clocked)
        for chunk in arrived.chunks:
            parser.feed(*chunk)
        described = clocked if parser.clock.dates_frames else described
    if described.framing == "binary" and described.tail == 1:
        kinds = ("values", "sum8", "xor8")
        more += [msgspec.structs.replace(described, tail=0, checksum=kind) for kind in kinds]
    return next((each for each in more if reads(each, arrived.data)), described)


def _reading_of(described: PadFormat) -> tuple[object, ...]:
    """Return the grid of a description and what its values mean."""
    grid = (described.framing, described.rows, described.columns)
    return (*grid, described.full_scale, described.invert)


def as_yaml(described: PadFormat) -> str:
    """Return a description as it stands in the configuration, on one line."""
    for name, preset in PRESETS.items():
        if preset == described:
            return f"format: {name}"
    always = {"framing": described.framing, "rows": described.rows, "columns": described.columns}
    fields = always | msgspec.to_builtins(described) | {"full_scale": described.full_scale}
    shown = {key: f"{value:g}" if key == "full_scale" else json.dumps(value) for key, value in fields.items()}
    return f"format: {{{', '.join(f'{key}: {value}' for key, value in shown.items())}}}"
