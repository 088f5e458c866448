"""Finds and proves the description of a pad from its bytes, given its rows and columns.

The grid's size leaves a few possible placements of the cells in a frame. The one whose neighbours correlate
most is proposed if a hand presses the pad and touchd's own parser reads nearly all that arrived.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from msgspec import to_builtins
from msgspec.structs import replace

from touchd.drivers.frame import MIN_RATE_HZ, Frame
from touchd.drivers.pace import relative_clock
from touchd.drivers.pad.binary import CLOCK_BYTES
from touchd.drivers.pad.clock import MAX_STEP_S
from touchd.drivers.pad.format import LONGEST_SIDE, PRESETS, SHORTEST_SIDE, Layout, PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.search import binary, text
from touchd.drivers.search.listen import MOST_BYTES, Chunk, seconds_of
from touchd.drivers.search.proof import Placement, movement, objection, pairs, settled, thinned

Grid = tuple[int, int]
SIDES = range(SHORTEST_SIDE, LONGEST_SIDE + 1)
# Correlation is divided by this power of the roughness, the mean step. The wrong byte order is up to 256
# times rougher, cells with a checksum among them a third; with one slow number they are 1 % smoother.
ROUGHNESS = 0.1
# Share of what arrived that the parser must read, as docs/pads.md promises.
EXPLAINED = 0.98
# A preset fits if the parser reads this share of what arrived. The proof also requires this share of the
# later frames: a one-byte header that also occurs inside the pad's longer header would shift all cells.
MOSTLY = 0.9
# The fastest rate of a format, plus 5 % for measuring it over seconds.
FASTEST_HZ = 525.0
# The longest pause between frames; the third study's gaps are shorter.
LONGEST_PAUSE_S = 2.0
# The pad's clock may differ from the arrival of frames by this share, as frames may arrive late.
CLOSE = 0.2
# What a preset and a description of the same pad have in common.
MEANING = attrgetter("framing", "rows", "columns", "full_scale", "invert")
ADVICE = "print each frame in a line, or a row a line and an empty line after each; begin bytes with a header"


class Survey(NamedTuple):
    """What a pad sends.

    frame: the size of a frame, in words. rate_hz: frames a second. grid: rows and columns, None if the frames
    do not show them; why: how they were found.
    """

    frame: str
    rate_hz: float
    grid: Grid | None = None
    why: str = ""


@dataclass(frozen=True)
class Finding:
    """What a search found.

    proposed: the description, if it is proven. missing: why nothing is proposed, "" if something is. arrived:
    what arrived, in words. may_be_proven: whether more presses may prove a description.
    """

    proposed: PadFormat | None
    missing: str
    arrived: str
    may_be_proven: bool = False


def survey(chunks: Sequence[Chunk]) -> Survey | None:
    """Describe the frames in what arrived, without knowing the grid; None if there are none."""
    data, seconds = b"".join(chunk.data for chunk in chunks), seconds_of(chunks)
    lines = text.lines_of(data)
    seen = _of_bytes(data, seconds) if lines is None else _of_lines(lines, seconds)
    if seen is None or seen.grid is not None:
        return seen
    read = ((name, preset) for name, preset in PRESETS.items() if _is_read(preset, chunks))
    name, preset = next(read, ("", None))
    return seen._replace(grid=(preset.rows, preset.columns), why=f"as {name}") if preset else seen


def _of_bytes(data: bytes, seconds: float) -> Survey | None:
    table = next(binary.tables(data), None)
    if table is None:
        return None
    length = table.shape[1] // 2
    return Survey(f"{length} bytes a frame", len(data) / length / seconds)


def _of_lines(lines: Sequence[text.TextLine], seconds: float) -> Survey | None:
    # Log lines among frames of one line look like separators.
    found = text.printed(lines)
    usual = max(found, key=lambda each: len(each.numbers) >= MIN_RATE_HZ * seconds, default=None)
    if usual is None:
        return None
    count, height, width = usual.numbers.shape
    # Numbers that count from frame to frame, or from line to line, are not cells.
    by_frame, by_line = (binary.counting(each) for each in (usual.numbers, usual.numbers.swapaxes(0, 1)))
    columns = width - int((by_frame.all(axis=0) | by_line.all(axis=0)).sum())
    grid = (height, columns) if height in SIDES and columns in SIDES else None
    return Survey(f"{height * width} numbers a frame", count / seconds, grid, "as its lines show")


def search(chunks: Sequence[Chunk], grid: Grid | None) -> Finding:
    """Search for the description of a pad in its bytes. grid: its rows and columns, if known."""
    sizes = np.cumsum([len(chunk.data) for chunk in chunks[::-1]])
    chunks = chunks[len(chunks) - int(np.searchsorted(sizes, MOST_BYTES, "right")) :]
    data = b"".join(chunk.data for chunk in chunks)
    if not data:
        return Finding(None, "is it the pad's port, and does the pad run?", "nothing arrives")
    arrived = f"{len(data) / seconds_of(chunks):.0f} bytes/s of {text.looks_like(data)}"
    # A survey tries every preset, which takes longer than the rest of a search.
    seen = None if grid else survey(chunks)
    grid = grid or (seen.grid if seen else None)
    best = max(placements(chunks, grid), key=partial(_fit, chunks), default=None) if grid else None
    if best is None:
        return Finding(None, _why_none_fits(seen or survey(chunks), grid), arrived)
    return _judged(Placement(settled(best), best.values), chunks, arrived)


def _judged(best: Placement, chunks: Sequence[Chunk], arrived: str) -> Finding:
    """Propose a placement if a hand proves it and touchd's own parser reads what arrived."""
    may_be_proven = bool(missing := objection(best))
    described = best.described if may_be_proven else _completed(best.described, chunks)
    missing = missing or _unexplained(best, described, chunks)
    if missing:
        return Finding(None, f"perhaps {as_yaml(described)}; {missing}", arrived, may_be_proven)
    return Finding(described, "", arrived)


def as_yaml(described: PadFormat) -> str:
    """Return what a pad sends as it stands in the configuration, on one line."""
    sent = replace(described, turn=0, mirror=False)
    for name, preset in PRESETS.items():
        if preset == sent:
            return f"format: {name}"
    always = {"framing": sent.framing, "rows": sent.rows, "columns": sent.columns}
    fields = always | to_builtins(sent) | {"full_scale": sent.full_scale}
    shown = {key: f"{value:g}" if key == "full_scale" else json.dumps(value) for key, value in fields.items()}
    return f"format: {{{', '.join(f'{key}: {value}' for key, value in shown.items())}}}"


def placements(chunks: Sequence[Chunk], grid: Grid) -> Iterator[Placement]:
    """Yield the placements of a grid's cells in the frames of what arrived; a clock is not a cell."""
    data = b"".join(chunk.data for chunk in chunks)
    lines = text.lines_of(data)
    placed = binary.placements(data, *grid) if lines is None else text.placements(lines, *grid)
    return (each for each in placed if not binary.counting(each.values).any())


def _fit(chunks: Sequence[Chunk], placed: Placement) -> tuple[float, bool, float, float]:
    """Return a sort key: the neighbours' correlation relative to roughness, then what decides between equals.

    That is a checksum that holds, or cells that rest evenly: a header among border cells that never change
    rests elsewhere.
    """
    is_checked = placed.described.tail == 1 and _completed(placed.described, chunks).checksum != "none"
    steps = np.abs(np.diff(thinned(placed.values), axis=0)).mean(axis=0)
    roughness = max(float(steps.sum()) / max(int((steps > 0).sum()), 1), 1e-9)
    moved, (one, other) = movement(placed.values), pairs(placed.cells)
    fit = float((moved[:, one] * moved[:, other]).sum() / one.size) / roughness**ROUGHNESS
    return round(fit, 2), is_checked, round(fit, 4), -float(np.ptp(np.median(placed.values, axis=0)))


def _why_none_fits(seen: Survey | None, grid: Grid | None) -> str:
    if seen is None:
        return f"no frames, or a wrong baud rate: {ADVICE}"
    if grid is None:
        return f"{seen.frame}; say --grid ROWSxCOLUMNS"
    return f"{seen.frame}, which do not fit {grid[0]}x{grid[1]} cells; say another --grid, or {ADVICE}"


def _parsed(described: PadFormat, chunks: Sequence[Chunk]) -> tuple[FrameParser, list[Frame]]:
    """Return the daemon's parser of a description after all that arrived, and the frames that it read."""
    parser = FrameParser(described)
    return parser, [frame for chunk in chunks for frame in parser.feed(*chunk)]


def _is_read(described: PadFormat, chunks: Sequence[Chunk]) -> bool:
    """Whether the parser of a description reads nearly all that arrived."""
    counts = _parsed(described, chunks)[0].counts
    return counts.frames >= text.LEAST_FRAMES and counts.frames > MOSTLY * (counts.frames + counts.bad)


def _completed(described: PadFormat, chunks: Sequence[Chunk]) -> PadFormat:
    """Return a description with the clock and checksum beside its cells, or a preset that describes more."""
    more = [each for each in PRESETS.values() if MEANING(each) == MEANING(described)]
    described = next((each for each in _clocked(described) if _is_dated(each, chunks)), described)
    if described.framing == "binary" and described.tail == 1:
        more += [replace(described, tail=0, checksum=kind) for kind in ("values", "sum8", "xor8")]
    return next((each for each in more if _is_read(each, chunks) and _is_dated(each, chunks)), described)


def _clocked(described: PadFormat) -> Iterator[PadFormat]:
    """Yield a description with the first of what it skips taken as a clock, in each unit."""
    in_bytes = CLOCK_BYTES if described.framing == "binary" else 0
    if described.skip >= max(in_bytes, 1):
        for unit in ("ms", "us", "s"):
            yield replace(described, clock=unit, skip=described.skip - in_bytes)


def _is_dated(described: PadFormat, chunks: Sequence[Chunk]) -> bool:
    """Whether a description's clock, if any, orders nearly all frames and keeps pace with their arrival."""
    if not described.has_clock:
        return True
    parser, frames = _parsed(described, chunks)
    counts = parser.counts
    if not parser.dates_frames or len(frames) < text.LEAST_FRAMES or counts.restarts:
        return False
    is_steady = counts.bad_time <= (1 - EXPLAINED) * len(frames) and counts.duplicates <= len(frames)
    return is_steady and abs(relative_clock(frames) - 1) <= CLOSE


def _unexplained(placed: Placement, described: PadFormat, chunks: Sequence[Chunk]) -> str:
    """Return what the daemon's own parser cannot read of what arrived, in words; "" if it reads enough."""
    parser, frames = _parsed(described, chunks)
    read, layout = {frame.pressure.tobytes() for frame in frames}, Layout(described)
    # Only the later half: at first the parser holds frames back until it trusts the clock.
    later = np.clip(placed.values[len(placed.values) // 2 :], 0, described.full_scale)
    if np.mean([layout.pressure(each).tobytes() in read for each in later]) < MOSTLY:
        return "touchd's parser reads other cells: is its header among them, or a first number that jumps?"
    explained = 1 - (parser.counts.bad - parser.counts.bad_time - 1) / len(placed.values)
    if explained < EXPLAINED:
        return f"that explains {100 * explained:.0f} % of what came, not {100 * EXPLAINED:.0f} %"
    waits_s = np.diff([chunks[0].host_s, *(frame.host_s for frame in frames), chunks[-1].host_s])
    rate_hz, pause_s = 1 / max(float(waits_s[1:-1].mean()), 1e-3), float(waits_s.max())
    if not MIN_RATE_HZ <= rate_hz <= FASTEST_HZ or pause_s > LONGEST_PAUSE_S:
        return f"{rate_hz:.1f} frames/s come, pausing for up to {pause_s:.1f} s; 8 to 500 are needed"
    if not described.has_clock and 2 * waits_s[waits_s > MAX_STEP_S].sum() > waits_s.sum():
        return f"frames come in bursts, pausing for up to {pause_s:.1f} s: send the pad's clock with each"
    return ""
