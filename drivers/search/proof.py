"""What has to hold before cells are proposed as a pad: a hand presses them, and the parser reads them."""

import math
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from touchd.drivers.frame import MAX_COUNT, MIN_RATE_HZ
from touchd.drivers.pad.format import CELL_TOP, PadFormat, layout_of
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

# The parser has to read this share of what came, and most of what it reads are the cells that were found.
EXPLAINED, MOSTLY = 0.98, 0.9
FASTEST_HZ = 525.0
# Frames come evenly if no part of the time has fewer or more than usual by this factor, and no longer pause.
# The third study's streams do, with their gaps.
PARTS, UNEVEN, LONGEST_PAUSE_S = 8, 3.0, 1.5
# Neighbours exceed shuffled cells by this many standard deviations: 93 % of the third study's touches do (by
# S08, S11 and S14), and 1 % of their shuffled cells.
SURE = 2.5
# The farthest movement under a hand, in noises: 12 or more in these streams, 6 or less at rest.
PRESSED_NOISES = 8.0
# The 30th percentile of a normal distribution's absolute deviations; a pad may be pressed half the time.
NORMAL_30 = 0.385
# A hand moves cells one way, and the other way by less than this share: by 0.54 at most in these streams.
# Signed values count from rest, so a hand that stays longer does not hide that.
BOTH_WAYS, SELDOM_AT_REST = 0.6, 0.25
# The following were chosen on 240 generated formats, which they tell apart.
# Other numbers are among the cells if fewer than this share have a fraction, or if more than this many beside
# them are pressed (a total, a mean and a centre make four).
FEW, MOST_FOLLOWING = 0.2, 4
# A pressed number keeps this share of its movement from one frame to the next; a checksum does not.
LASTS = 0.5
# If all cells change in more frames than this share, one that never changes is no cell.
ALWAYS = 0.1
# Two bytes are no number if more steps than this share are leaps of the upper byte alone: 0.07 by chance.
FEW_LEAPS = 0.3
# A byte that wraps steps by more than this.
WRAP = 192
# Two kinds of frames come by turns if the frame after next is nearer than the next by this factor.
TURNS = 0.8
FULL_SCALES, ROUND = (1023, 4095, 65535), (1, 2, 5, 10)
# A configuration takes no larger full_scale; a parser cannot divide by a smaller one.
SMALLEST_SCALE, LARGEST_SCALE = 1e-30, 4e9
# A press must move a cell by this many counts of the model's scale: less is detected, but not recognised.
LEAST_PRESS = 16.0


def strays(values: Numbers) -> Numbers:
    """Return how far each of (frames, numbers) strays at rest: from frame to frame, or slowly."""
    off, steps = np.abs(values - np.median(values, axis=0)), np.abs(np.diff(values, axis=0))
    of_each: Numbers = np.maximum(np.median(steps, axis=0), np.quantile(off, 0.3, axis=0) / NORMAL_30)
    return of_each


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
    off = values - np.quantile(values, SELDOM_AT_REST if values.min() < 0 else 0.5, axis=0)
    of_each, steps = strays(values), np.abs(np.diff(values, axis=0))
    usual = np.median(of_each[of_each > 0]) if 4 * (of_each > 0).sum() > len(of_each) else 0.0
    noise = float(max(usual, steps[steps > 0].min(initial=np.inf) if steps.any() else 1.0))
    largest = float(np.abs(off).max())
    if largest <= PRESSED_NOISES * noise:
        return f"nothing presses the pad (its numbers move by {largest:.4g}): press it while I listen"
    above, below = (np.maximum(sign * off - 2 * noise, 0).sum() for sign in (1, -1))
    if min(above, below) > BOTH_WAYS * max(above, below):
        return "a hand moves its numbers up and down: print pressure, not how it changes"
    cells = np.arange(values.shape[1]).reshape(reading.grid)
    moved = movement(reading.values)
    if deviations(moved, cells) < SURE:
        return "neighbouring cells do not move together: press one place at a time, all over the pad"
    if runs_to_and_fro(moved, cells):
        return "every other row seems to run backwards: print all rows in one direction"
    next_one, after_next = (np.square(reading.values[n:] - reading.values[:-n]).mean() for n in (1, 2))
    if after_next < TURNS * next_one:
        return "frames of two kinds come by turns: two pads on one line?"
    return _misread(reading.described, reading.values) if reading.described.framing == "binary" else ""


def _misread(described: PadFormat, values: Numbers) -> str:
    """Say why binary cells are of another kind than they seem; "" if they may be right."""
    steps = np.diff(values, axis=0)
    if described.cell in ("u16", "i16"):
        # An upper byte of its own makes values leap by multiples of 256; unused bits make gaps.
        leaps = (np.abs(steps) >= 128) & (np.abs((steps + 128) % 256 - 128) <= 8)
        bits = values.astype(np.int64)
        changing = int(np.bitwise_or.reduce(bits, axis=None) ^ np.bitwise_and.reduce(bits, axis=None))
        changing //= changing & -changing or 1
        if leaps.sum() > FEW_LEAPS * (steps != 0).sum() or changing & (changing + 1):
            return "its two bytes do not make one number: send plain u8, u16, i16 or f32 cells"
    if described.cell == "u8":
        # A number moves against the jump before and after it wraps.
        before, jumps, after = steps[:-2], steps[1:-1], steps[2:]
        wraps = (np.abs(jumps) > WRAP) & (before * jumps < 0) & (after * jumps < 0)
        signed = np.abs(np.diff((values + 128) % 256, axis=0))
        if 2 * wraps.sum() > (np.abs(jumps) > WRAP).sum() + 16 or 2 * signed.sum() < np.abs(steps).sum():
            return "its bytes seem to be signed, or halves of larger numbers: send u8, u16, i16 or f32 cells"
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
        scale = float(f"{(math.ceil(1e3 * largest / unit) / 1e3 if is_inverted else rounded) * unit:.6g}")
    return replace(described, full_scale=scale, invert=is_inverted)


def unscaled(described: PadFormat, values: Numbers) -> str:
    """Say why values are not pressure on the description's scale."""
    top, rest = described.full_scale, np.median(values, axis=0)
    if not SMALLEST_SCALE <= top <= LARGEST_SCALE:
        return f"its numbers go up to {top:g}: print values of a usual size"
    farthest = float(np.abs(values - rest).max())
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
    expected = {layout.pressure(np.clip(frame, 0, described.full_scale)).tobytes() for frame in values}
    counts, middle_s = parser.counts, chunks[len(chunks) // 2].host_s
    came_s: list[float] = []
    as_expected = late = held = 0
    for chunk in chunks:
        held_before = counts.bad_time
        frames = parser.feed(chunk.data, chunk.host_s)
        as_expected += sum(frame.pressure.tobytes() in expected for frame in frames)
        late += len(frames) * (chunk.host_s > middle_s)
        held += (counts.bad_time - held_before) * (chunk.host_s > middle_s)
        came_s += [chunk.host_s] * (counts.frames + counts.duplicates + counts.bad_time - len(came_s))
    if as_expected < MOSTLY * counts.frames or not came_s:
        return "touchd's parser reads other cells: a header occurs among them"
    # A number that is taken for a clock holds frames back, at first only if it is one.
    if late < max(EXPLAINED * (late + held), sum(at_s > middle_s for at_s in came_s) / 2):
        return "its first number is taken for a clock, but jumps: print it after the cells"
    read = len(came_s) / max(len(came_s) + counts.bad - counts.bad_time - 1, len(values))
    if read < EXPLAINED:
        return f"that explains {100 * read:.0f} % of what came, not {100 * EXPLAINED:.0f} %"
    seconds = chunks[-1].host_s - chunks[0].host_s
    if len(came_s) > FASTEST_HZ * seconds:
        return f"{len(came_s) / max(seconds, 1e-3):.0f} frames/s come; {MIN_RATE_HZ:g} to 500 are needed"
    parts, _ = np.histogram(came_s, PARTS, (chunks[0].host_s, chunks[-1].host_s))
    is_uneven = UNEVEN * parts.min() < np.median(parts) or parts.max() > UNEVEN * np.median(parts)
    if is_uneven or np.diff(came_s).max(initial=0) > LONGEST_PAUSE_S:
        return "frames do not come at a steady rate, or only while the pad is pressed"
    return ""
