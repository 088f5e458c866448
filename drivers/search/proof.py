"""What has to hold before cells are proposed as a pad: a hand presses them, and neighbours move together."""

import math
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from touchd.drivers.frame import MAX_COUNT
from touchd.drivers.pad.format import CELL_TOP, PadFormat

Numbers = NDArray[np.float64]
Moved = NDArray[np.float32]
Cells = NDArray[np.int_]

# Frames compared, and shuffles. With 300 to 2000 frames, 2 % of the third study's touches differ.
MOST_FRAMES, SHUFFLES = 500, 200
# If rows run to and fro, cells move with those below them, read backwards, as with those beside them: 0.9 to
# 1.0 times on generated pads, and below 0.5 times on the third study's, which does not.
BACKWARDS = 0.7
# Neighbours exceed shuffled cells by this many standard deviations: 67 of 75 of the third study's touches by
# S10, S12, S15 and S18 do, and four of 438 streams with shuffled cells.
SURE = 2.5
# A pad is at rest for a quarter of the time, and 30 % of its values stay near their median: a hand moves a
# cell by more than this times as far, by 27 times in 19 of 20 of these touches; channels that swing, 4 times.
AT_REST, NEAR_REST, FARTHER = 0.25, 0.3, 10.0
# Rows and columns are turned if neighbours then move together more by this: by 0.07 to 0.33 on a firm pad.
TIE = 0.005
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
# Full scales: those of usual converters for whole numbers, round numbers for others.
CONVERTERS = (1023.0, 4095.0, 65535.0)
ROUND = tuple(each * 10.0**power for power in range(-6, 7) for each in (1, 2, 5))
# A press must move a cell by this many counts of the model's scale: less is detected, but not recognised. At
# rest, the third study's cells move by up to 13. Values that fall from the lower half, or rise from the upper
# one, must move farther: by 20 to 33 in three of that study's recordings, as after a hand that has left.
LEAST_PRESS, FIRM_PRESS = 16.0, 48.0


@dataclass(frozen=True, eq=False)
class Placement:
    """A description that may fit what arrived, and the values (frames, cells) that it reads."""

    described: PadFormat
    values: Numbers

    @property
    def cells(self) -> Cells:
        """The cells' numbers, laid out as the grid."""
        return np.arange(self.values.shape[1]).reshape(self.described.rows, self.described.columns)


def thinned(numbers: Numbers) -> Numbers:
    """Return evenly spaced frames of (frames, numbers), at most MOST_FRAMES."""
    return numbers[:: -(-len(numbers) // MOST_FRAMES)]


def movement(values: Numbers) -> Moved:
    """Return how each cell steps from frame to frame, among the others, as ranks; each cell has unit length.

    Ranks leave out what most cells share, and weigh a light touch like a firm one.
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


def together(moved: Moved, one: Cells, other: Cells) -> float:
    """Return how much cells move together with others, on average; at most 1."""
    return float((moved[:, one.ravel()] * moved[:, other.ravel()]).sum() / one.size)


def runs_to_and_fro(moved: Moved, cells: Cells) -> bool:
    """Whether every other row of a grid is sent backwards: read so, cells move with those below them."""
    backwards = cells.copy()
    backwards[1::2] = cells[1::2, ::-1]
    beside = together(moved, cells[:, :-1], cells[:, 1:])
    return together(moved, backwards[:-1], backwards[1:]) > BACKWARDS * beside


def deviations(moved: Moved, cells: Cells) -> float:
    """Return by how many standard deviations neighbours move together more than shuffled cells do."""
    shared = moved.T @ moved
    one, other = pairs(cells)
    rng = np.random.default_rng(0)
    shuffled = (rng.permutation(cells.size) for _ in range(SHUFFLES))
    by_chance = np.array([shared[order[one], order[other]].mean() for order in shuffled])
    return float((shared[one, other].mean() - by_chance.mean()) / max(by_chance.std(), 1e-9))


def objection(placed: Placement) -> str:
    """Say why a placement's cells are not a pressed pad; "" if they are proven to be one."""
    if missing := _unpressed(placed.described, placed.values):
        return missing
    moved = movement(placed.values)
    if deviations(moved, placed.cells) < SURE:
        return "neighbouring cells do not move together: press one place at a time, all over the pad"
    if runs_to_and_fro(moved, placed.cells):
        return "every other row seems to run backwards: print all rows in one direction"
    if _jumping(placed.values) > JUMPY:
        return "its numbers jump: other rows and columns, two pads, or cells not u8, u16, i16 or f32?"
    still = set(placed.values[0, np.ptp(placed.values, axis=0) == 0].tolist())
    if placed.described.skip + placed.described.tail and len(still) > FEW_STILL:
        return "numbers among its cells never change: press all over the pad; print the cells in one piece"
    return ""


def _unpressed(described: PadFormat, values: Numbers, least: float = LEAST_PRESS) -> str:
    """Say why the values do not look as if a hand pressed cells and let go; "" if they do."""
    values = thinned(values) * (-1 if described.invert else 1)
    off = values - np.quantile(values, AT_REST, axis=0)
    farthest = float(off.max())
    if farthest * MAX_COUNT < least * described.full_scale:
        return f"nothing presses the pad (change: {farthest:.4g} of {described.full_scale:g}): press firmly"
    near = float(np.quantile(np.abs(values - np.median(values, axis=0)), NEAR_REST))
    if farthest <= FARTHER * near or np.maximum(-off, 0).sum() > BOTH_WAYS * np.maximum(off, 0).sum():
        return "its numbers never rest, or swing: let go between presses; print pressure, not changes"
    return ""


def _jumping(values: Numbers) -> float:
    """Return the share that jumps, against the step before and after, have in the squares of all steps."""
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
    rows, columns = placed.cells.shape[::-1] if _is_turned(placed) else placed.cells.shape
    described = replace(described, rows=rows, columns=columns, full_scale=scale)
    likelier, other = (replace(described, invert=invert) for invert in (falls, not falls))
    is_other = _unpressed(likelier, values) and not _unpressed(other, values, FIRM_PRESS)
    return other if is_other else likelier


def _is_turned(placed: Placement) -> bool:
    """Whether neighbours move together more if rows and columns are taken the other way round."""
    moved, cells, turned = movement(placed.values), placed.cells.ravel(), placed.cells.T.shape
    # Under a wide hand, cells of one row move together too; those just below one another do more.
    before, below = (together(moved, cells[lag:], cells[:-lag]) for lag in (turned[1] - 1, turned[1]))
    more = together(moved, *pairs(cells.reshape(turned))) - together(moved, *pairs(placed.cells))
    return below > before and more > TIE
