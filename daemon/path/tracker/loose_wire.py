"""Takes out the jumps of a loose wire: a row or column that steps while nothing touches the pad.

As a body breathes and a connector flexes, the taxels of one line jump together by several counts and back,
while all others keep still. A hand moves other taxels too, and the line does not keep still before and after.
Readings of such a line within the height of its jumps carry no information, so they are replaced by those at
rest.
"""

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.path.tracker.baseline import TAXELS, Taxels
from touchd.drivers.frame import COLUMNS, ROWS

# (16, 64): which taxels are on each line, rows before columns.
LINES = np.array([*np.eye(ROWS).repeat(COLUMNS, axis=1), *np.tile(np.eye(COLUMNS), ROWS)], np.float32)
LINE_TAXELS = TAXELS // ROWS

# The constants were chosen on the breathing robot's sessions: five of its 16 set-ups have a loose wire.
# A jump is the difference between the means of the first and the last three of 15 frames.
STEP_FRAMES = 3
LOOK_FRAMES = 15
# The least height of a jump.
LEAST_COUNTS = 2.0
# Three quarters of the line's taxels move by at least this share of the height; the others move by at most as
# much on average.
OTHERS_SHARE = 0.25
# The most that a single other taxel may move; on a noisy pad, it may move by the height.
HIGHEST_COUNTS = 3.0
# Three frames make up this share of the height; before and after, the line stays within it; and the jump back
# differs from the jump by at most this share.
STEP_SHARE = 0.5
# Learned heights halve in two minutes at rest, at six checks a second.
KEPT = 0.999


class LooseWire:
    """Learns from a pad at rest which rows and columns jump, and by how much.

    lines: their names, counted from 1.
    """

    def __init__(self) -> None:
        self.lines: tuple[str, ...] = ()
        self._heights = np.zeros(TAXELS, np.float32)
        self._jumped: dict[int, Taxels] = {}

    def take_out(self, frames: NDArray[np.float32], rest: Taxels) -> NDArray[np.float32]:
        """Return (..., 8, 8) counts moved towards rest by the learned heights; if none, the same array."""
        if not self.lines:
            return frames
        heights = self._heights.reshape(ROWS, COLUMNS)
        above = frames - rest.reshape(ROWS, COLUMNS)
        without: NDArray[np.float32] = frames - np.clip(above, -heights, heights)
        return without

    def look(self, frames: NDArray[np.float32]) -> bool:
        """Look for a jump in the last (LOOK_FRAMES, 64) counts at rest; return whether a line was learned.

        frames: without the jumps learned so far.
        """
        if self.lines:
            self._heights *= KEPT
        change = (np.add.reduce(frames[-STEP_FRAMES:]) - np.add.reduce(frames[:STEP_FRAMES])) / STEP_FRAMES
        means = (LINES @ change / LINE_TAXELS).tolist()
        line = max(range(len(means)), key=lambda line: abs(means[line]))
        height = abs(means[line])
        if height < LEAST_COUNTS:
            return False
        is_on_line = LINES[line] > 0
        jump, others = change[is_on_line], np.abs(change[~is_on_line])
        share, lower_quarter = OTHERS_SHARE * height, np.sort(jump * np.sign(means[line]))[LINE_TAXELS // 4]
        if lower_quarter < share or others.mean() > share or others.max() > max(HIGHEST_COUNTS, height):
            return False
        return _is_steady(frames[:, is_on_line].mean(axis=1), height) and self._learn(line, jump)

    def _learn(self, line: int, jump: Taxels) -> bool:
        """Learn the heights of a line once it has jumped there and back."""
        before = self._jumped.get(line)
        if before is not None and np.abs(before + jump).sum() <= STEP_SHARE * np.abs(jump).sum():
            self._heights[LINES[line] > 0] += np.abs(jump)
            self._jumped.clear()
            name = f"row {line + 1}" if line < ROWS else f"column {line - ROWS + 1}"
            self.lines = tuple(sorted({*self.lines, name}))
            return True
        # One jump is seen several times; keep the highest view of it.
        if before is None or before.mean() * jump.mean() < jump.mean() ** 2:
            self._jumped[line] = jump
        return False


def _is_steady(means: NDArray[np.float32], height: float) -> bool:
    """Whether a line's means (T,) jump within a few frames and keep still before and after."""
    steps = np.abs(means[STEP_FRAMES:] - means[:-STEP_FRAMES])
    at = int(steps.argmax())
    moved = max(float(np.ptp(means[: at + 1])), float(np.ptp(means[at + STEP_FRAMES :])))
    return float(steps[at]) >= STEP_SHARE * height and moved <= STEP_SHARE * height
