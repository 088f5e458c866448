"""Proves that cells are a pad: a hand presses them, and neighbours move together."""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from touchd.drivers.frame import MAX_COUNT
from touchd.drivers.pad.format import CELL_TOP, PadFormat

Numbers = NDArray[np.float64]
Moved = NDArray[np.float32]
Cells = NDArray[np.int_]

# The limits below were chosen on 75 touches of the third study (S10, S12, S15 and S18).

# Frames compared, and random shuffles of the cells. Between 300 and 2000 frames, 2 % of the verdicts differ.
MOST_FRAMES, SHUFFLES = 500, 200
# Cells are out of order if some that are farther apart correlate more than nearer ones by this: in 2 of 340
# touches, and in 9 of 10 generated pads whose rows, columns or halves are out of order.
MOST_DISORDER = 0.4
# Neighbours must correlate more than shuffled cells by this many standard deviations: 67 of the 75 touches
# pass, and 4 of 438 streams with shuffled cells.
SURE = 2.5
# A press must exceed the resting spread tenfold; touches exceed it 27-fold (5th percentile), channels that
# oscillate 4-fold. A cell rests at its lower quartile; the spread is the 30th percentile of the distances of
# all values from their cell's median.
AT_REST, NEAR_REST, FARTHER = 0.25, 0.3, 10.0
# Movement against the press must be less than this share of the movement with it: it is 0.26 in touches (95th
# percentile), 0.9 in channels that oscillate.
BOTH_WAYS = 0.4
# A jump is a step against the steps before and after it. Jumps must make up less than this share of the sum
# of squared steps. It is 0.15 or less for a generated hand at 8 to 50 Hz, and 0.4 in one touch; 0.6 or more
# if two pads alternate, a byte wraps, or numbers are parts of other numbers.
JUMPY = 0.5
# Dead cells read 0 or full scale throughout. More than two constant values are not cells, but row numbers or
# the headers of packets.
FEW_STILL = 2
# 16-bit cells may be half floats near 0 if nearly all are 0 or have the bits of 2^-11 or more,
# and rest at 0 or spread: generated ones by 128 or more, whole numbers of 5,000 to 20,000 by at most 40.
SIGN, TINY_HALF, INFINITY, MOST_HALVES, HALVES_SPREAD = 0x8000, 0x1000, 0x7C00, 0.985, 64.0
# Full scales: those of common converters for whole numbers, round numbers for others.
CONVERTERS = (1023.0, 4095.0, 65535.0)
ROUND = tuple(each * 10.0**power for power in range(-6, 7) for each in (1, 2, 5))
# A press must move a cell by this many of the model's counts; a lighter one is detected but not recognised.
# At rest, cells move by up to 13. Values that fall from the lower half of the scale, or rise from the upper
# half, need a firm press: when a hand leaves they move by 20 to 33 in three of the recordings. Values below 0
# are lost; cells of the recordings rest at down to -36.
LEAST_PRESS, FIRM_PRESS = 16.0, 48.0


@dataclass(frozen=True, eq=False)
class Placement:
    """A description that may fit what arrived, and the values (frames, cells) that it gives."""

    described: PadFormat
    values: Numbers

    @property
    def cells(self) -> Cells:
        """The cells' numbers, laid out as the grid."""
        return np.arange(self.values.shape[1]).reshape(self.described.rows, self.described.columns)


def thinned(numbers: Numbers) -> Numbers:
    """Return every n-th of (frames, numbers), at most MOST_FRAMES; n is odd: two pads may alternate."""
    return numbers[:: -(-len(numbers) // MOST_FRAMES) | 1]


def movement(values: Numbers) -> Moved:
    """Return each cell's steps from frame to frame as ranks among all cells, scaled to unit length.

    Ranks cancel what most cells share, and weigh a light touch like a firm one.
    """
    steps = np.diff(thinned(values), axis=0)
    ranks = [
        np.searchsorted(ordered, step, "left") + np.searchsorted(ordered, step, "right")
        for ordered, step in zip(np.sort(steps, axis=1), steps, strict=True)
    ]
    moved = (np.array(ranks, np.float32) - steps.shape[1]) * steps.any(axis=0)
    unit: Moved = moved / np.maximum(np.linalg.norm(moved, axis=0), 1e-9)
    return unit


def pairs(cells: Cells) -> tuple[Cells, Cells]:
    """Return the neighbours in a grid of cells: one of each pair, and the other."""
    one = np.concatenate([cells[:, :-1].ravel(), cells[:-1].ravel()])
    other = np.concatenate([cells[:, 1:].ravel(), cells[1:].ravel()])
    return one, other


def disorder(values: Numbers, shape: tuple[int, int]) -> float:
    """Return by how much cells farther apart correlate more than nearer ones, at most: 0 for a perfect grid.

    It correlates steps from frame to frame, over all pairs that are as many rows and columns apart.
    """
    rows, columns = shape
    steps = np.diff(thinned(values), axis=0)
    unit = (steps / np.maximum(np.linalg.norm(steps, axis=0), 1e-9)).reshape(-1, rows, columns)
    padded = (2 * rows, 2 * columns)
    power = np.square(np.abs(np.fft.rfft2([*unit, unit.any(axis=0)], padded)))
    shared, pairs_there = np.fft.irfft2([power[:-1].sum(axis=0), power[-1]], padded)
    shared /= np.maximum(pairs_there, min(shape))
    apart = np.maximum(shared[:rows, :columns], shared[:rows, -np.arange(columns)])
    nearer = np.minimum.accumulate(np.minimum.accumulate(apart, axis=0), axis=1)
    return float((apart - np.maximum(nearer, 0)).max())


def deviations(moved: Moved, cells: Cells) -> float:
    """Return by how many standard deviations neighbours correlate more than shuffled cells."""
    shared = moved.T @ moved
    one, other = pairs(cells)
    rng = np.random.default_rng(0)
    shuffled = (rng.permutation(cells.size) for _ in range(SHUFFLES))
    by_chance = np.array([shared[order[one], order[other]].mean() for order in shuffled])
    return float((shared[one, other].mean() - by_chance.mean()) / max(by_chance.std(), 1e-9))


def objection(placed: Placement) -> str:
    """Return why a placement's cells are not a pressed pad; "" if they are proven to be one."""
    if missing := _unpressed(placed.described, placed.values):
        return missing
    sent = placed.described
    if sent.framing == "binary" and sent.cell in ("u16", "i16") and _may_be_halves(placed.values):
        return "its cells look like half floats: send u16 or f32; if they are whole, write this format"
    lowest = placed.values if placed.described.invert else np.quantile(placed.values, AT_REST, axis=0)
    if -float(lowest.min()) * MAX_COUNT > FIRM_PRESS * placed.described.full_scale:
        return "its numbers fall below 0, which touchd reads as 0: print pressure from 0 up"
    moved = movement(placed.values)
    if deviations(moved, placed.cells) < SURE:
        return "neighbouring cells do not move together: press one place at a time, all over the pad"
    if _jumping(placed.values) > JUMPY:
        return "its numbers jump: other rows and columns, two pads, or cells of another type?"
    if disorder(placed.values, placed.cells.shape) > MOST_DISORDER:
        return "its cells come in another order: is the grid right? send rows one way, nothing between them"
    still = set(placed.values[0, np.ptp(placed.values, axis=0) == 0].tolist())
    if placed.described.skip + placed.described.tail and len(still) > FEW_STILL:
        return "numbers among its cells never change: press all over the pad; print the cells in one piece"
    return ""


def _unpressed(described: PadFormat, values: Numbers, least: float = LEAST_PRESS) -> str:
    """Return why the values do not look as if a hand pressed cells and let go; "" if they do."""
    values = thinned(values) * (-1 if described.invert else 1)
    off = values - np.quantile(values, AT_REST, axis=0)
    farthest = float(off.max())
    if farthest * MAX_COUNT < least * described.full_scale:
        return f"nothing presses the pad (change: {farthest:.4g} of {described.full_scale:g}): press firmly"
    near = float(np.quantile(np.abs(values - np.median(values, axis=0)), NEAR_REST))
    if farthest <= FARTHER * near or np.maximum(-off, 0).sum() > BOTH_WAYS * np.maximum(off, 0).sum():
        return "its numbers never rest, or swing: let go between presses; print pressure, not changes"
    return ""


def _may_be_halves(values: Numbers) -> bool:
    """Whether 16-bit values have the bits of half floats of usual sizes that rest near 0."""
    is_usual = (values == 0) | ((values % SIGN >= TINY_HALF) & (values % SIGN < INFINITY))
    rest = np.median(values, axis=0)
    spread = np.quantile(np.abs(values - rest), NEAR_REST)
    return bool(is_usual.mean() >= MOST_HALVES and (spread > HALVES_SPREAD or not np.median(rest)))


def _jumping(values: Numbers) -> float:
    """Return the share of jumps in the sum of squared steps."""
    steps = np.diff(values, axis=0)
    before, jumps, after = steps[:-2], steps[1:-1], steps[2:]
    is_against = (before * jumps < 0) & (after * jumps < 0)
    return float((np.square(jumps) * is_against).sum() / max(np.square(steps).sum(), 1e-9))


def settled(placed: Placement) -> PadFormat:
    """Return a placement's description with the order of its sides, full_scale and invert set."""
    described, values = placed.described, placed.values
    top = CELL_TOP.get(described.cell, math.inf) if described.framing == "binary" else math.inf
    largest = float(values.max())
    usual = CONVERTERS if (values == np.round(values)).all() else ROUND
    scale = min(next((each for each in usual if each >= largest), largest), top)
    rest = np.median(values, axis=0)[np.ptp(values, axis=0) > 0]
    falls = bool(rest.size and np.median(rest) > scale / 2)
    rows, columns = min(placed.cells.shape, placed.cells.T.shape, key=partial(disorder, values))
    described = replace(described, rows=rows, columns=columns, full_scale=scale)
    likelier, other = (replace(described, invert=invert) for invert in (falls, not falls))
    is_other = _unpressed(likelier, values) and not _unpressed(other, values, FIRM_PRESS)
    return other if is_other else likelier
