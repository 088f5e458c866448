"""A row or column that jumps while nothing touches the pad: a loose wire, which a body that breathes moves.

Its taxels jump together by several counts and back, again and again, while all others keep still. A hand
moves others too, and does not hold still before and after. Up to the height of its jumps, what such a line
reads says nothing, so that much is taken out.
"""

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.tracker.baseline import TAXELS, Taxels
from touchd.drivers.frame import COLUMNS, ROWS

# A jump lies between two means of so many frames, in the last so many.
MEAN_FRAMES = 3
LOOK_FRAMES = 15
# The line's mean moves by so much, and so many of its taxels with it.
LEAST_COUNTS = 2.0
LEAST_TAXELS, TAXEL_COUNTS = 6, 0.7
# The other taxels move by no more, on average and at most; on a noisy pad, by such shares of the jump.
OTHERS_COUNTS, OTHERS_SHARE = 0.6, 0.25
HIGHEST_COUNTS, HIGHEST_SHARE = 3.0, 1.0
# So few frames see most of a jump; before and after, the line stays within a share of it.
STEP_FRAMES, STEP_SHARE, STEADY_SHARE = 3, 0.7, 0.5
# The way back differs from the way there by less than this share.
UNLIKE = 0.5
# At nine looks a second, half is forgotten in 77 seconds at rest.
KEPT = 0.999


class LooseWire:
    """Learns, from a pad at rest, which rows and columns jump, and by how much."""

    def __init__(self) -> None:
        self.lines: tuple[str, ...] = ()
        """Those known, counted from 1."""
        self._counts = np.zeros(TAXELS, np.float32)
        self._jumped: dict[int, Taxels] = {}

    def take_out(self, frames: NDArray[np.float32], rest: Taxels) -> NDArray[np.float32]:
        """Return (..., 8, 8) counts, nearer to those at rest by what a loose line jumps, or that array."""
        if not self.lines:
            return frames
        counts = self._counts.reshape(ROWS, COLUMNS)
        off = frames - rest.reshape(ROWS, COLUMNS)
        without: NDArray[np.float32] = frames - np.clip(off, -counts, counts)
        return without

    def look(self, frames: NDArray[np.float32]) -> bool:
        """Look for a jump in the last (LOOK_FRAMES, 64) counts at rest; return whether a line is known anew.

        frames: what is known of a line already is taken out.
        """
        self._counts *= KEPT
        change = frames[-MEAN_FRAMES:].mean(axis=0) - frames[:MEAN_FRAMES].mean(axis=0)
        rows = change.reshape(ROWS, COLUMNS)
        means = np.concatenate([rows.mean(axis=1), rows.mean(axis=0)])
        line = int(np.abs(means).argmax())
        height = abs(float(means[line]))
        if height < LEAST_COUNTS:
            return False
        is_on_line = _mask(line)
        jump, others = change[is_on_line], np.abs(change[~is_on_line])
        if (
            others.mean() > max(OTHERS_COUNTS, OTHERS_SHARE * height)
            or others.max() > max(HIGHEST_COUNTS, HIGHEST_SHARE * height)
            or np.count_nonzero(jump * np.sign(means[line]) >= TAXEL_COUNTS) < LEAST_TAXELS
        ):
            return False
        return _is_steady(frames[:, is_on_line].mean(axis=1), height) and self._learn(line, jump)

    def _learn(self, line: int, jump: Taxels) -> bool:
        """Learn a line that has jumped there and back."""
        last = self._jumped.get(line)
        if last is not None and np.abs(last + jump).sum() <= UNLIKE * np.abs(jump).sum():
            self._counts[_mask(line)] += np.abs(jump)
            self._jumped.clear()
            name = f"row {line + 1}" if line < ROWS else f"column {line - ROWS + 1}"
            self.lines = tuple(sorted({*self.lines, name}))
            return True
        # Of several the same way keep the highest: the others were still under way.
        if last is None or last.mean() * jump.mean() < jump.mean() ** 2:
            self._jumped[line] = jump
        return False


def _mask(line: int) -> NDArray[np.bool_]:
    """Return (64,), which taxels are on a line: rows, then columns."""
    mask = np.zeros((ROWS, COLUMNS), np.bool_)
    if line < ROWS:
        mask[line] = True
    else:
        mask[:, line - ROWS] = True
    return mask.reshape(-1)


def _is_steady(course: NDArray[np.float32], height: float) -> bool:
    """Whether a line's mean (T,) jumps within a few frames and keeps still before and after."""
    steps = np.abs(course[STEP_FRAMES:] - course[:-STEP_FRAMES])
    at = int(steps.argmax())
    moved = max(float(np.ptp(course[: at + 1])), float(np.ptp(course[at + STEP_FRAMES :])))
    return float(steps[at]) >= STEP_SHARE * height and moved <= STEADY_SHARE * height
