"""What has to hold before cells are proposed as a pad: a hand presses them, and the parser reads them."""

import math
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from touchd.drivers.frame import MAX_COUNT, MIN_RATE_HZ
from touchd.drivers.pad.format import CELL_TOP, PadFormat, layout_of
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.search.listen import Chunk
from touchd.drivers.search.neighbours import (
    Numbers,
    Placement,
    deviations,
    falls,
    movement,
    runs_to_and_fro,
    thinned,
)

# The parser has to read this share of what came, as docs/pads.md promises, and this share of the later frames
# that were found; a header that also occurs among the cells shifts more.
EXPLAINED, MOSTLY = 0.98, 0.9
# The fastest rate of a format, and 5 % for the error of one that is measured over seconds.
FASTEST_HZ = 525.0
# The parser may hold frames back for a second and a half, until it knows what their clock counts.
UNTIL_DATED = 0.25
# Frames come evenly if no part of the time has fewer or more than usual by this factor, and no longer pause.
# The third study's streams do, with their gaps.
PARTS, UNEVEN, LONGEST_PAUSE_S = 8, 3.0, 1.5
# Neighbours exceed shuffled cells by this many standard deviations: 67 of 75 of the third study's touches by
# S10, S12, S15 and S18 do, and four of 438 streams with shuffled cells.
SURE = 2.5
# A hand moves a cell by more noises than this: by 11 or more in nine of ten of these touches. At rest, their
# cells move by up to 12, but by fewer counts than LEAST_PRESS.
PRESSED_NOISES = 6.0
# The 30th percentile of a normal distribution's absolute deviations; a pad may be pressed half the time.
NORMAL_30 = 0.385
# A hand moves cells one way, and the other way by less than this share: by 0.42 in 19 of 20 of these touches;
# channels that oscillate exceed it. A hand may stay on a cell for three quarters of the time.
BOTH_WAYS, SELDOM_AT_REST = 0.6, 0.25
# A frame's cells differ from the next frame's by less than this share of how they move in all (squares): by
# 0.03 in 19 of 20 of these touches. Bytes of larger numbers, signed bytes and two pads by turns exceed it.
JUMPY = 0.6
# Two bytes are not one number if in more than this share of steps the upper byte leaps alone: 0.01 in
# generated frames of u16 and i16, 0.7 in those of half floats and of low and high bytes apart.
FEW_LEAPS = 0.3
# A byte that wraps steps by more than this. In generated frames of low bytes, 97 % of such steps wrap; in
# those of u8 cells, 7 % look like it.
WRAP = 192
# Dead cells read 0 or full scale throughout; more values that never change are other numbers.
FEW_STILL = 2
# The largest values of usual converters; other scales end at these times a power of ten.
FULL_SCALES, ROUND = (1023, 4095, 65535), (1, 2, 5, 10)
# A configuration takes no larger full_scale; a parser cannot divide by a smaller one.
SMALLEST_SCALE, LARGEST_SCALE = 1e-30, 4e9
# A press must move a cell by this many counts of the model's scale: less is detected, but not recognised.
LEAST_PRESS = 16.0


def objection(placed: Placement) -> str:
    """Say why a placement's cells are not a pressed pad; "" if they are proven to be one."""
    values = thinned(placed.values)
    rest = 1 - SELDOM_AT_REST if falls(values) else SELDOM_AT_REST
    off = values - np.quantile(values, rest, axis=0)
    noise, largest = noise_of(values), float(np.abs(off).max())
    if largest <= PRESSED_NOISES * noise:
        return f"nothing presses the pad (its numbers move by {largest:.4g}): press it while I listen"
    above, below = (np.maximum(sign * off - 2 * noise, 0).sum() for sign in (1, -1))
    if min(above, below) > BOTH_WAYS * max(above, below):
        return "a hand moves its numbers up and down: print pressure, not how it changes"
    moved = movement(placed.values)
    if deviations(moved, placed.cells) < SURE:
        return "neighbouring cells do not move together: press one place at a time, all over the pad"
    if runs_to_and_fro(moved, placed.cells):
        return "every other row seems to run backwards: print all rows in one direction"
    jumps = np.square(np.diff(placed.values, axis=0)).mean()
    if jumps > JUMPY * np.square(off).mean():
        return "its numbers jump: are two pads on the line, or cells not u8, u16, i16 or f32?"
    if placed.described.framing == "binary" and _is_misread(placed):
        return "its bytes seem to be parts of other numbers: send plain u8, u16, i16 or f32 cells"
    still = values[0, np.ptp(values, axis=0) == 0]
    if placed.described.skip + placed.described.tail and len(set(still.tolist())) > FEW_STILL:
        return (
            "numbers among its cells never change: press all over the pad, and print the cells in one piece"
        )
    return ""


def _is_misread(placed: Placement) -> bool:
    """Whether cells are parts of larger numbers, or signed bytes."""
    values, cell = placed.values, placed.described.cell
    steps = np.diff(values, axis=0)
    if cell in ("u16", "i16"):
        # An upper byte of its own makes values leap by multiples of 256.
        leaps = (np.abs(steps) >= 128) & (np.abs((steps + 128) % 256 - 128) <= 8)
        return bool(leaps.sum() > FEW_LEAPS * (steps != 0).sum())
    # A number moves against the jump before and after it wraps.
    before, jumps, after = steps[:-2], steps[1:-1], steps[2:]
    wraps = (np.abs(jumps) > WRAP) & (before * jumps < 0) & (after * jumps < 0)
    return cell == "u8" and bool(2 * wraps.sum() > (np.abs(jumps) > WRAP).sum() + 16)


def noise_of(values: Numbers) -> float:
    """Return how far (frames, cells) stray at rest, from frame to frame or slowly, in most cells that do."""
    off, steps = np.abs(values - np.median(values, axis=0)), np.abs(np.diff(values, axis=0))
    of_each = np.maximum(np.median(steps, axis=0), np.quantile(off, 0.3, axis=0) / NORMAL_30)
    usual = np.median(of_each[of_each > 0]) if 4 * (of_each > 0).sum() > len(of_each) else 0.0
    return float(max(usual, steps[steps > 0].min(initial=np.inf) if steps.any() else 1.0))


def scaled(placed: Placement) -> PadFormat:
    """Return a placement's description with its full_scale and invert set."""
    described, largest = placed.described, float(placed.values.max())
    top = CELL_TOP.get(described.cell, math.inf) if described.framing == "binary" else math.inf
    if largest <= 0:
        scale = 1.0
    elif (placed.values == np.round(placed.values)).all():
        usual = (each for each in (top if top < FULL_SCALES[0] else 0, *FULL_SCALES) if each >= largest)
        scale = min(next(usual, largest), top)
    else:
        unit = 10.0 ** math.floor(math.log10(largest))
        scale = next(each for each in ROUND if largest <= each * unit) * unit
    return replace(described, full_scale=scale, invert=falls(thinned(placed.values)))


def unscaled(described: PadFormat, values: Numbers) -> str:
    """Say why values are not pressure on the description's scale."""
    top, rest = described.full_scale, np.median(values, axis=0)
    if not SMALLEST_SCALE <= top <= LARGEST_SCALE:
        return f"its numbers go up to {top:g}: print values of a usual size"
    farthest = float(
        (rest - values if described.invert else np.maximum(values, 0) - np.maximum(rest, 0)).max()
    )
    if farthest * MAX_COUNT < LEAST_PRESS * top:
        return (
            f"a press moves its numbers by only {farthest:.4g} of {top:g}: press firmly, or print the change"
        )
    if (np.median(rest[np.ptp(values, axis=0) > 0]) > top / 2) != described.invert:
        return "its numbers rest at the end to which a hand seems to move them: let go between presses"
    return ""


def unexplained(described: PadFormat, values: Numbers, chunks: Sequence[Chunk]) -> str:
    """Say what a description leaves unexplained when the daemon's own parser reads all that arrived."""
    parser, layout = parser_of(described), layout_of(described)
    frames = [frame for chunk in chunks for frame in parser.feed(*chunk)]
    read = {frame.pressure.tobytes() for frame in frames}
    # At first, a number that is taken for a clock may hold frames back.
    later = np.clip(values[len(values) // 2 :], 0, described.full_scale)
    if np.mean([layout.pressure(each).tobytes() in read for each in later]) < MOSTLY:
        return (
            "touchd's parser reads other cells, or none: a header among them, or a first number that jumps?"
        )
    counts = parser.counts
    explained = 1 - (counts.bad - counts.bad_time - 1) / len(values)
    if explained < EXPLAINED:
        return f"that explains {100 * explained:.0f} % of what came, not {100 * EXPLAINED:.0f} %"
    return _uneven(np.array([frame.host_s for frame in frames]), chunks[0].host_s, chunks[-1].host_s)


def _uneven(came_s: Numbers, first_s: float, last_s: float) -> str:
    """Say why frames do not come at a pad's rate, once their clock is known."""
    first_s += UNTIL_DATED * (last_s - first_s)
    came_s = came_s[came_s >= first_s]
    parts, _ = np.histogram(came_s, PARTS, (first_s, last_s))
    gaps_s = np.diff(came_s)
    rate_hz = len(gaps_s) / max(float(gaps_s.sum()), 1e-3)
    if not MIN_RATE_HZ <= rate_hz <= FASTEST_HZ:
        return f"{rate_hz:.1f} frames/s come; {MIN_RATE_HZ:g} to 500 are needed"
    is_uneven = UNEVEN * parts.min() < np.median(parts) or parts.max() > UNEVEN * np.median(parts)
    if is_uneven or gaps_s.max(initial=0) > LONGEST_PAUSE_S:
        return "frames do not come at a steady rate, or only while the pad is pressed"
    return ""
