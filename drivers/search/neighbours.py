"""How much neighbouring cells move together: it decides where the cells lie, and proves a grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.pad.format import PadFormat

Numbers = NDArray[np.float64]
Moved = NDArray[np.float32]
Cells = NDArray[np.int_]

# Frames that are compared, and shuffles. With 300 to 2000 frames, two of a hundred of the third study's
# touches differ.
MOST_FRAMES, SHUFFLES = 500, 200
# If rows run to and fro, cells move with those below them, read backwards, as with those beside them: 0.9 to
# 1.0 times on generated pads, and below 0.5 times on the third study's, which does not.
BACKWARDS = 0.7


@dataclass(frozen=True, eq=False)
class Placement:
    """A description that may fit what arrived, and the values (frames, cells) that it reads."""

    described: PadFormat
    values: Numbers

    @property
    def cells(self) -> Cells:
        """The cells' numbers, laid out as the grid."""
        rows, columns = self.described.rows, self.described.columns
        return np.arange(rows * columns).reshape(rows, columns)


def thinned(numbers: Numbers) -> Numbers:
    """Return evenly spaced frames of (frames, numbers), at most MOST_FRAMES."""
    return numbers[:: -(-len(numbers) // MOST_FRAMES)]


def movement(values: Numbers) -> Moved:
    """Return how each cell steps from frame to frame, among the others, as ranks; each cell has unit length.

    Ranks leave out what most cells share, and weigh a light touch like a firm one. A cell that never
    steps shows nothing.
    """
    steps = np.diff(thinned(values), axis=0)
    ordered = np.sort(steps, axis=1)
    ranks = [
        np.searchsorted(*each, "left") + np.searchsorted(*each, "right")
        for each in zip(ordered, steps, strict=True)
    ]
    moved = (np.array(ranks, np.float32) - steps.shape[1]) * steps.any(axis=0)
    unit: Moved = moved / np.maximum(np.sqrt(np.square(moved).sum(axis=0)), 1e-9)
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


def is_turned(placed: Placement) -> bool:
    """Whether the cells of a grid seem to be sent column by column: they move as those a column later do."""
    moved, (rows, columns) = movement(placed.values), placed.cells.shape
    return rows != columns and _is_stride(moved, rows) and not _is_stride(moved, columns)


def _is_stride(moved: Moved, lag: int) -> bool:
    """Whether cells at this distance move together more than those a step nearer or farther."""
    nearer, here, farther = (float((moved[:, :-at] * moved[:, at:]).sum()) for at in (lag - 1, lag, lag + 1))
    return here > max(nearer, farther)


def deviations(moved: Moved, cells: Cells) -> float:
    """Return by how many standard deviations neighbours move together more than shuffled cells do."""
    shared = moved.T @ moved
    one, other = pairs(cells)
    rng = np.random.default_rng(0)
    shuffled = (rng.permutation(cells.size) for _ in range(SHUFFLES))
    by_chance = np.array([shared[order[one], order[other]].mean() for order in shuffled])
    return float((shared[one, other].mean() - by_chance.mean()) / max(by_chance.std(), 1e-9))
