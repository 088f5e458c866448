"""What has to hold before cells are proposed as a pad: a hand presses them, and the parser reads them."""

import math
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from touchd.drivers.frame import MAX_COUNT, MIN_RATE_HZ
from touchd.drivers.pad.binary import frame_bytes
from touchd.drivers.pad.format import CELL_TOP, PadFormat, layout_of
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.search.listen import Chunk
from touchd.drivers.search.neighbours import (
    Numbers,
    Reading,
    counting,
    deviations,
    falls,
    movement,
    runs_to_and_fro,
    thinned,
)
from touchd.drivers.search.text import LEAST_FRAMES

FASTEST_HZ = 525.0
# The parser has to read this share of what came.
EXPLAINED = 0.98
# Frames come evenly if no part of the time has fewer or more than its share by this factor.
PARTS, UNEVEN = 8, 3.0
# A pad that sends nothing for this long sends only while it is pressed.
LONGEST_PAUSE_S = 1.5
# Neighbours exceed shuffled cells by this many standard deviations.
SURE = 2.5
# The farthest movement under a hand, in noises.
PRESSED_NOISES = 8.0
# The 30th percentile of a normal distribution's absolute deviations; a pad may be pressed half the time.
NORMAL_30 = 0.385
# A hand moves the cells one way: the other way, by less than this share.
BOTH_WAYS = 0.6
FULL_SCALES = (1023, 4095, 65535)
ROUND = (1, 2, 5, 10)
# A configuration takes no larger full_scale; a parser cannot divide by a smaller one.
SMALLEST_SCALE, LARGEST_SCALE = 1e-30, 4e9
# A press must move a cell by this many counts of the model's scale: less is detected, but not recognised.
LEAST_PRESS = 16.0
SELDOM_AT_REST = 0.25
MOSTLY = 0.9
FEW = 0.2
MOST_FOLLOWING = 4
LASTS = 0.5
ALWAYS = 0.1
FEW_LEAPS = 0.3
WRAP = 192
TURNS = 0.8


def rest_of(values: Numbers) -> Numbers:
    """Return what (frames, numbers) read at rest.

    A hand may stay on a pad for most of the time. Only signed values, which count from rest, show that.
    """
    rest: Numbers = np.quantile(values, SELDOM_AT_REST if values.min(initial=0) < 0 else 0.5, axis=0)
    return rest


def strays(values: Numbers) -> Numbers:
    """Return how far each of (frames, numbers) strays at rest: from frame to frame, or slowly."""
    off = np.abs(values - np.median(values, axis=0))
    steps = np.abs(np.diff(values, axis=0))
    of_each: Numbers = np.maximum(np.median(steps, axis=0), np.quantile(off, 0.3, axis=0) / NORMAL_30)
    return of_each


def noise_of(values: Numbers) -> float:
    """Return how far the cells of a pad stray at rest; at least the smallest step that they make."""
    of_each = strays(values)
    alive = of_each[of_each > 0]
    usual = float(np.median(alive)) if 4 * len(alive) > len(of_each) else 0.0
    steps = np.abs(np.diff(values, axis=0))
    smallest = float(steps[steps > 0].min()) if steps.any() else 1.0
    return max(usual, smallest)


def is_mixed(reading: Reading) -> bool:
    """Whether some numbers are no cells: a header or a row number inside, or a second pad beside them."""
    values = thinned(reading.values)
    fractions = (values % 1 != 0).any(axis=0)
    if 0 < fractions.mean() < FEW or _pressed(thinned(reading.beside)).sum() > MOST_FOLLOWING:
        return True
    still = (np.ptp(values, axis=0) == 0).reshape(reading.grid)
    if not reading.beside.shape[1] or still.all():
        return False
    # Rows and columns that read the same throughout may be without a wire, and zeros dead cells.
    rest = np.median(values, axis=0).reshape(reading.grid)
    wireless = [still.all(axis) & (np.ptp(rest, axis) == 0) for axis in (0, 1)]
    odd = still & (rest != 0) & ~wireless[0] & ~wireless[1][:, None]
    if (np.abs(np.diff(values, axis=0)) > 0).mean(axis=0)[~still.ravel()].min() < ALWAYS:
        odd &= (rest < rest[~still].min()) | (rest > rest[~still].max())
    return bool(odd.any())


def _pressed(numbers: Numbers) -> NDArray[np.bool_]:
    """Whether each of (frames, numbers) rests at times and else moves smoothly, as under a hand."""
    off = numbers - np.median(numbers, axis=0)
    lasts = (off[1:] * off[:-1]).sum(axis=0) > LASTS * np.square(off).sum(axis=0)
    moves = np.abs(off).max(axis=0, initial=0) > PRESSED_NOISES * np.maximum(strays(numbers), 1e-9)
    pressed: NDArray[np.bool_] = lasts & moves & ~counting(numbers)
    return pressed


def objection(reading: Reading) -> str:
    """Say why a reading's cells are not a pressed pad; "" if they are proven to be one."""
    values = thinned(reading.values)
    off, noise = values - rest_of(values), noise_of(values)
    largest = float(np.abs(off).max())
    if largest <= PRESSED_NOISES * noise:
        return f"nothing presses the pad (its numbers move by {largest:.4g}): press it while I listen"
    above, below = (np.maximum(sign * off - 2 * noise, 0).sum() for sign in (1, -1))
    if min(above, below) > BOTH_WAYS * max(above, below):
        return "a hand moves its numbers up and down: print pressure, not how it changes"
    if deviations(movement(reading.values), np.arange(values.shape[1]).reshape(reading.grid)) < SURE:
        return "neighbouring cells do not move together: press one place at a time, all over the pad"
    return _misread(reading, values)


def _misread(reading: Reading, values: Numbers) -> str:
    """Say why the cells are of another kind than they seem, or in another order; "" if they may be right."""
    described = reading.described
    steps = np.diff(reading.values, axis=0)
    if described.framing == "binary" and described.cell in ("u16", "i16"):
        far = np.abs(steps) >= 128
        leaps = far & (np.abs((steps + 128) % 256 - 128) <= 8)
        bits = values.astype(np.int64)
        changing = int(np.bitwise_or.reduce(bits, axis=None) ^ np.bitwise_and.reduce(bits, axis=None))
        changing //= changing & -changing or 1
        if leaps.sum() > FEW_LEAPS * (steps != 0).sum() or changing & (changing + 1):
            return "its two bytes do not make one number: send plain u8, u16, i16 or f32 cells"
    if described.framing == "binary" and described.cell == "u8":
        before, jumps, after = steps[:-2], steps[1:-1], steps[2:]
        wraps = (np.abs(jumps) > WRAP) & (before * jumps < 0) & (after * jumps < 0)
        signed = np.abs(np.diff((reading.values + 128) % 256, axis=0))
        if (
            wraps.sum() > (np.abs(jumps) > WRAP).sum() / 2 + LEAST_FRAMES
            or 2 * signed.sum() < np.abs(steps).sum()
        ):
            return "its bytes seem to be signed, or halves of larger numbers: send u8, u16, i16 or f32 cells"
    rows, columns = reading.grid
    if runs_to_and_fro(movement(reading.values), np.arange(rows * columns).reshape(rows, columns)):
        return "every other row seems to run backwards: print all rows in one direction"
    next_one, after_next = (np.square(reading.values[n:] - reading.values[:-n]).mean() for n in (1, 2))
    if after_next < TURNS * next_one:
        return "frames of two kinds come by turns: two pads on one line?"
    return ""


def scaled(reading: Reading) -> PadFormat:
    """Return a reading's description with its full_scale and invert set."""
    described, values = reading.described, reading.values
    largest, is_inverted = float(values.max()), falls(thinned(values))
    top = CELL_TOP.get(described.cell, math.inf) if described.framing == "binary" else math.inf
    if top == CELL_TOP["u8"]:
        scale = top
    elif (values == np.round(values)).all():
        scale = min(next((each for each in FULL_SCALES if largest <= each), largest), top)
    elif largest <= 0:
        scale = 1.0
    else:
        # Pads rest at full scale if it means no pressure; otherwise a later press may be firmer.
        unit = 10.0 ** math.floor(math.log10(largest))
        rounded = next(each for each in (*ROUND, math.inf) if largest <= each * unit)
        units = 1e-3 * math.ceil(1e3 * largest / unit) if is_inverted else rounded
        scale = float(f"{units * unit:.6g}")
    return replace(described, full_scale=scale, invert=is_inverted)


def unscaled(described: PadFormat, values: Numbers) -> str:
    """Say why values are not pressure on the description's scale."""
    top = described.full_scale
    if not SMALLEST_SCALE <= top <= LARGEST_SCALE:
        return f"its numbers go up to {top:g}: print values of a usual size"
    rest = np.median(values, axis=0)
    farthest = float(np.abs(values - rest).max())
    if farthest * MAX_COUNT < LEAST_PRESS * top:
        return (
            f"a press moves its numbers by only {farthest:.4g} of {top:g}: press firmly; if they go no "
            "farther, set full_scale by hand, and print what a press adds where they rest far from 0"
        )
    is_high = np.median(rest[np.ptp(values, axis=0) > 0]) > top / 2
    if is_high != described.invert:
        return (
            "its numbers rest on the wrong side of their range for the way in which a hand seems to move "
            "them: let go of the pad between presses"
        )
    return ""


def unexplained(described: PadFormat, values: Numbers, chunks: Sequence[Chunk]) -> str:
    """Say what a description leaves unexplained when the daemon's own parser reads all that arrived."""
    parser, layout = parser_of(described), layout_of(described)
    expected = {layout.pressure(np.clip(frame, 0, described.full_scale)).tobytes() for frame in values}
    came_s: list[float] = []
    as_expected = late = 0
    for chunk in chunks:
        before = _judged(parser)
        frames = parser.feed(chunk.data, chunk.host_s)
        as_expected += sum(frame.pressure.tobytes() in expected for frame in frames)
        came_s += [chunk.host_s] * (_judged(parser) - before)
        late += len(frames) * (chunk.host_s > chunks[len(chunks) // 2].host_s)
    if len(came_s) < LEAST_FRAMES or as_expected < MOSTLY * parser.counts.frames:
        return "touchd's parser reads other cells: a header occurs among them"
    # A number that is taken for a clock holds frames back, at first only if it is one.
    if late < EXPLAINED * sum(at_s > chunks[len(chunks) // 2].host_s for at_s in came_s):
        return "its first number is taken for a clock, but jumps: print it after the cells"
    refused = parser.counts.bad - parser.counts.bad_time
    share = len(came_s) / (len(came_s) + max(refused - 1, 0))
    if described.framing == "binary":
        share = min(
            share, (len(came_s) + 2) * frame_bytes(described) / sum(len(chunk.data) for chunk in chunks)
        )
    if share < EXPLAINED:
        return f"that explains {100 * share:.0f} % of what came, not {100 * EXPLAINED:.0f} %"
    return uneven(came_s, chunks[0].host_s, chunks[-1].host_s)


def _judged(parser: FrameParser) -> int:
    """Return how many frames a parser has read, whatever it thought of their clock."""
    return parser.counts.frames + parser.counts.duplicates + parser.counts.bad_time


def uneven(came_s: Sequence[float], first_s: float, last_s: float) -> str:
    """Say why frames that came at these times do not come at a steady rate."""
    rate_hz = len(came_s) / max(last_s - first_s, 1e-3)
    if not MIN_RATE_HZ <= rate_hz <= FASTEST_HZ:
        return f"{rate_hz:.1f} frames/s come; {MIN_RATE_HZ:g} to 500 are needed"
    if max(np.diff([first_s, *came_s])) > LONGEST_PAUSE_S:
        return "at times no frame comes: the pad has to send while nothing presses it, too"
    parts, _ = np.histogram(came_s, PARTS, (first_s, last_s))
    if parts.max() > UNEVEN * np.median(parts) or UNEVEN * parts.min() < np.median(parts):
        return "frames do not come at a steady rate"
    return ""
