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
# A pad is at rest for a quarter of the time, and 30 % of its values stay near their median: a hand moves a
# cell by more than this times as far, by 27 times in 19 of 20 of these touches; channels that swing, 4 times.
AT_REST, NEAR_REST, FARTHER = 0.25, 0.3, 10.0
# A hand moves cells one way, and the other way by less than this share: by 0.26 in 19 of 20 of these touches;
# by 0.9 on channels that oscillate.
BOTH_WAYS = 0.4
# A step against those before and after it is a jump. Jumps hold less than this share of the squares of all
# steps: at most 0.15 of a generated hand's at 8 to 50 Hz, 0.4 in one of these touches; 0.6 and more where two
# pads take turns, where a byte wraps, and in numbers that are parts of others.
JUMPY = 0.5
# Dead cells read 0 or full scale throughout; more values that never change are other numbers, such as those
# of rows, or headers of packets that hold a part of a frame.
FEW_STILL = 2
# The largest values of usual converters; other scales end at these times a power of ten.
FULL_SCALES, ROUND = (1023, 4095, 65535), (1, 2, 5, 10)
# A press must move a cell by this many counts of the model's scale: less is detected, but not recognised. At
# rest, the third study's cells move by up to 13.
LEAST_PRESS = 16.0


def objection(placed: Placement) -> str:
    """Say why a placement's cells are not a pressed pad; "" if they are proven to be one."""
    values, described = thinned(placed.values), placed.described
    off = values - np.quantile(values, 1 - AT_REST if described.invert else AT_REST, axis=0)
    off *= -1 if described.invert else 1
    farthest = float(off.max())
    if farthest * MAX_COUNT < LEAST_PRESS * described.full_scale:
        moves = f"its numbers move by {farthest:.4g} of {described.full_scale:g}"
        return f"nothing presses the pad ({moves}): press it firmly while I listen"
    near = float(np.quantile(np.abs(values - np.median(values, axis=0)), NEAR_REST))
    if farthest <= FARTHER * near or np.maximum(-off, 0).sum() > BOTH_WAYS * np.maximum(off, 0).sum():
        return (
            "its numbers never rest, or move up and down: let go between presses; print pressure, not changes"
        )
    moved = movement(placed.values)
    if deviations(moved, placed.cells) < SURE:
        return "neighbouring cells do not move together: press one place at a time, all over the pad"
    if runs_to_and_fro(moved, placed.cells):
        return "every other row seems to run backwards: print all rows in one direction"
    if _jumping(placed.values) > JUMPY:
        return "its numbers jump: are two pads on the line, or cells not u8, u16, i16 or f32?"
    still = values[0, np.ptp(values, axis=0) == 0]
    if described.skip + described.tail and len(set(still.tolist())) > FEW_STILL:
        return (
            "numbers among its cells never change: press all over the pad, and print the cells in one piece"
        )
    return ""


def _jumping(values: Numbers) -> float:
    """Return the share that jumps, against the step before and after, have in the squares of all steps."""
    steps = np.diff(values, axis=0)
    before, jumps, after = steps[:-2], steps[1:-1], steps[2:]
    is_against = (before * jumps < 0) & (after * jumps < 0)
    return float((np.square(jumps) * is_against).sum() / max(np.square(steps).sum(), 1e-9))


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
    rest = np.median(placed.values, axis=0)[np.ptp(placed.values, axis=0) > 0]
    return replace(described, full_scale=scale, invert=bool(rest.size and np.median(rest) > scale / 2))


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
