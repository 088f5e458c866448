"""How much neighbouring cells move together: it decides where the cells lie, and proves a grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.pad.format import PadFormat

Numbers = NDArray[np.float64]
Moved = NDArray[np.float32]
Cells = NDArray[np.int_]

# Chosen on the third study's touches by S08, S11 and S14, of which 93 % exceed SURE, and on generated
# pads. MOST_FRAMES that are compared: 300 to 2000 differ by two points. FEW_CHANGES: the weight of a frame in
# which nothing moves. PRESS_SHARE: the weight of presses, the rest is that of steps; with 0.1 a finger on 4x4
# cells is hardly seen, with 0.7 a tenth of the touches.
MOST_FRAMES, FEW_CHANGES, PRESS_SHARE, SHUFFLES = 500, 0.05, 0.3, 200
# A number that moves farther than nine of ten cells by this factor is limited to that: it may be a sum. With
# it, all checksums of the generated formats are told from cells.
MOST_REACH = 3.0
# If rows run to and fro, cells move with those below, read backwards, as with those beside them: 0.9 to 1.0
# times on generated pads, and below 0.5 times on the third study's, which does not.
BACKWARDS = 0.7


@dataclass(frozen=True, eq=False)
class Reading:
    """A description that fits what arrived, and what it reads.

    values: (frames, cells). beside: (frames, others), the numbers of the frames that are not cells.
    """

    described: PadFormat
    values: Numbers
    beside: Numbers

    @property
    def grid(self) -> tuple[int, int]:
        return self.described.rows, self.described.columns


def thinned(numbers: Numbers) -> Numbers:
    """Return evenly spaced frames of (frames, numbers), at most MOST_FRAMES."""
    return numbers[:: -(-len(numbers) // MOST_FRAMES)]


def movement(values: Numbers) -> Moved:
    """Return how far a press takes (frames, cells), then how they step; each cell has unit length.

    Steps alone show light touches better, but the cells of a coarse pad step against their neighbours while a
    finger passes. What most cells share does not count.
    """
    chosen = thinned(values)
    off = chosen - np.median(chosen, axis=0)
    pressed = np.maximum(-off if falls(chosen) else off, 0)
    steps = _unit(np.diff(chosen, axis=0))
    return np.vstack([PRESS_SHARE**0.5 * _unit(pressed), (1 - PRESS_SHARE) ** 0.5 * steps])


def falls(values: Numbers) -> bool:
    """Whether a hand makes the values fall; signed values count from rest, so they rise."""
    off = values - np.median(values, axis=0)
    scaled = off / max(float(np.abs(off).max(initial=0.0)), 1e-9)
    return bool(values.min(initial=0) >= 0 and (scaled**3).sum() < 0)


def _unit(moved: Numbers) -> Moved:
    moved = moved - np.median(moved, axis=1, keepdims=True)
    reach = np.sqrt(np.square(moved).mean(axis=0))
    moved *= np.minimum(1.0, MOST_REACH * np.quantile(reach, 0.9) / np.maximum(reach, 1e-30))
    energy = np.square(moved).sum(axis=1, keepdims=True)
    moved /= np.sqrt(energy + max(FEW_CHANGES * float(np.quantile(energy, 0.95)), 1e-30))
    unit: Moved = (moved / np.maximum(np.sqrt(np.square(moved).sum(axis=0)), 1e-9)).astype(np.float32)
    return unit


def pairs(cells: Cells) -> tuple[Cells, Cells]:
    """Return the neighbours in a grid of cells: one of each pair, and the other."""
    one = np.concatenate([cells[:, :-1].ravel(), cells[:-1].ravel()])
    other = np.concatenate([cells[:, 1:].ravel(), cells[1:].ravel()])
    return one, other


def together(moved: Moved, cells: Cells) -> float:
    """Return how much neighbours in a grid of cells move together, on average; at most 1."""
    return _shared(moved, *pairs(cells))


def runs_to_and_fro(moved: Moved, cells: Cells) -> bool:
    """Whether every other row of a grid is sent backwards: read so, cells move with those below them."""
    backwards = cells.copy()
    backwards[1::2] = cells[1::2, ::-1]
    beside = _shared(moved, cells[:, :-1], cells[:, 1:])
    below, below_it = (_shared(moved, each[:-1], each[1:]) for each in (cells, backwards))
    return below_it > max(BACKWARDS * beside, 2 * below)


def _shared(moved: Moved, one: Cells, other: Cells) -> float:
    return float((moved[:, one.ravel()] * moved[:, other.ravel()]).sum() / one.size)


def is_stride(moved: Moved, columns: int) -> bool:
    """Whether cells at this distance move together more than those a step nearer or farther."""
    lags = (columns - 1, columns, columns + 1)
    nearer, here, farther = (float((moved[:, :-lag] * moved[:, lag:]).sum()) for lag in lags)
    return here > max(nearer, farther)


def deviations(moved: Moved, cells: Cells) -> float:
    """Return by how many standard deviations neighbours move together more than shuffled cells do."""
    shared = moved.T @ moved
    one, other = pairs(cells)
    rng = np.random.default_rng(0)
    shuffled = (rng.permutation(cells.size) for _ in range(SHUFFLES))
    by_chance = np.array([shared[order[one], order[other]].mean() for order in shuffled])
    return float((shared[one, other].mean() - by_chance.mean()) / max(by_chance.std(), 1e-9))


def counting(numbers: Numbers) -> NDArray[np.bool_]:
    """Whether each of (frames, numbers) only counts: a clock, a frame number, or a byte of one."""
    steps = np.diff(numbers, axis=0)
    rises, falls = (steps > 0).mean(axis=0), (steps < 0).mean(axis=0)
    parts = [part for part in np.array_split(steps, 6) if len(part)]
    everywhere = np.all([(part > 0).any(axis=0) for part in parts], axis=0)
    # A byte of a counter wraps; 0.85 lets it do so every seventh frame.
    counts: NDArray[np.bool_] = (rises > 0.85) | (everywhere & (falls == 0))
    return counts
