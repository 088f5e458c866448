"""Finds the description of a pad in its bytes, told its rows and columns, and proves it.

Told the grid, arithmetic leaves a few placements of the cells in a frame. The one in which neighbours move
together most is proposed if a hand presses the pad and touchd's own parser reads nearly all that came.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from touchd.drivers.frame import MIN_RATE_HZ
from touchd.drivers.pad.arrived import has_text, is_text, looks_like
from touchd.drivers.pad.format import PRESETS, PadFormat
from touchd.drivers.search import binary, text
from touchd.drivers.search.listen import MOST_BYTES, Chunk
from touchd.drivers.search.neighbours import Reading, is_stride, movement, thinned, together
from touchd.drivers.search.proof import is_mixed, objection, scaled, unexplained, unscaled
from touchd.drivers.search.survey import Grid, Survey, survey

# A placement may be right if its neighbours move together by this share of the best one's, which a checksum
# among the cells may raise. Of these, take one that is hardly rougher than the smoothest. Chosen on 240
# generated formats.
NEAR, SMOOTH = 0.8, 1.03
NO_FRAMES_IN_TEXT = "no frames: print each in a line, or a row a line and an empty line after each frame"
NO_FRAMES_IN_BYTES = "no frames of one length: a wrong baud rate, or no header? send a header of two bytes"
CHANGING_WORDS = "the letters in its lines change (hexadecimal? two pads?): print one pad's numbers"
MIXED = (
    "numbers among or beside its cells are others: print the cells of one pad, and what changes after them"
)


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
    data, lines = arrived.data, arrived.lines
    if not data:
        return Finding(None, "is it the pad's port, and does the pad run?", "nothing arrives")
    saw = f"{len(data) / arrived.seconds:.0f} bytes/s of {looks_like(data)}"
    seen = arrived.survey
    grid = grid or (seen.grid if seen else None)
    fitting: list[Reading] = []
    if grid:
        fitting = list(binary.readings(data, *grid) if lines is None else text.readings(lines, *grid))
    if not fitting:
        return Finding(None, _why_none_fits(arrived, seen, grid), saw)
    best = _best([reading for reading in fitting if not is_mixed(reading)])
    return Finding(None, MIXED, saw, may_come=True) if best is None else _proven(best, arrived, saw)


def _why_none_fits(arrived: Arrived, seen: Survey | None, grid: Grid | None) -> str:
    if not arrived.data.strip() or has_text(arrived.data):
        return "print lines of numbers and nothing else"
    if seen is None:
        return NO_FRAMES_IN_BYTES if arrived.lines is None else NO_FRAMES_IN_TEXT
    printed = list(text.printed(arrived.lines or ()))
    if any(frames.changing > text.CHANGING for frames in printed):
        return CHANGING_WORDS
    if grid and printed and max(frames.numbers[0].size for frames in printed) < grid[0] * grid[1]:
        return NO_FRAMES_IN_TEXT
    unfit = f", which do not fit {grid[0]}x{grid[1]} cells" if grid else ""
    return f"{seen.frame}{unfit}; say --grid ROWSxCOLUMNS"


def _best(readings: Sequence[Reading]) -> Reading | None:
    """Return the likeliest reading: of the smoothest ones, that in which neighbours move together most."""
    placed = [_placed(reading) for reading in readings]
    most = max((rank[0] for _, rank, _ in placed), default=0.0)
    near = [each for each in placed if each[1][0] >= NEAR * most]
    least = min((roughness for *_, roughness in near), default=0.0)
    smooth = (each for each in near if each[2] <= SMOOTH * least)
    return max(smooth, key=lambda each: each[1], default=(None,))[0]


def _placed(reading: Reading) -> tuple[Reading, tuple[float, ...], float]:
    """Return a reading (turned, if its cells are sent column by column), its rank, and its roughness."""
    values = thinned(reading.values)
    rows, columns = reading.grid
    moved = movement(values)
    if rows != columns and is_stride(moved, rows) and not is_stride(moved, columns):
        rows, columns = columns, rows
        described = msgspec.structs.replace(reading.described, rows=rows, columns=columns)
        reading = replace(reading, described=described)
    steps = np.abs(np.diff(values, axis=0)).mean(axis=0)
    alive = int((steps > 0).sum())
    # If values are small, both byte orders read the same cells; boards that send are mostly little-endian.
    is_little = reading.described.order == "little"
    most = round(together(moved, np.arange(rows * columns).reshape(rows, columns)), 4)
    rank = most, alive, -float(np.ptp(np.median(values, axis=0))), is_little
    return reading, rank, float(steps.sum()) / max(alive, 1)


def _proven(best: Reading, arrived: Arrived, saw: str) -> Finding:
    """Return the description of a reading, with its proof or what the proof is missing."""
    described = scaled(best)
    rate_hz = len(best.values) / arrived.seconds
    if rate_hz < MIN_RATE_HZ:
        too_slow = f"{rate_hz:.1f} frames/s come; {MIN_RATE_HZ:g} or more are needed"
        return Finding(None, too_slow, saw, described)
    if missing := objection(best) or unscaled(described, best.values):
        return Finding(None, missing, saw, described, may_come=True)
    if arrived.lines is None:
        described = binary.complete(described, best, arrived.data, arrived.seconds)
    if missing := unexplained(described, best.values, arrived.chunks):
        return Finding(None, missing, saw, described)
    described = as_preset(described)
    return Finding(described, "", saw, described)


def as_preset(described: PadFormat) -> PadFormat:
    """Return the preset with the same line, grid and direction; for text, only if the preset has a crop."""
    for preset in PRESETS.values():
        same = (preset.line, preset.rows, preset.columns, preset.invert)
        is_same = same == (described.line, described.rows, described.columns, described.invert)
        if is_same and (preset.framing == "binary" or preset.crop):
            return preset
    return described


def as_yaml(described: PadFormat) -> str:
    """Return a description as it stands in the configuration, on one line."""
    for name, preset in PRESETS.items():
        if preset == described:
            return f"format: {name}"
    always = {"framing": described.framing, "rows": described.rows, "columns": described.columns}
    fields = always | msgspec.to_builtins(described) | {"full_scale": described.full_scale}
    shown = {key: f"{value:g}" if key == "full_scale" else json.dumps(value) for key, value in fields.items()}
    return f"format: {{{', '.join(f'{key}: {value}' for key, value in shown.items())}}}"
