"""Light contact, which may be a touch, a baseline that shifted or a pad that wobbles."""

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.pad.baseline import SECOND_FRAMES, TAXELS, Baseline, LastSecond, Taxels
from touchd.drivers.frame import COLUMNS, ROWS

BACKDATE_COUNTS = 1.0
# A baseline's shift is over after two frames; a hand goes on moving.
STEP_FRAMES = 2
# A loose wire lifts a row or column by up to so much.
WIRE_COUNTS = 25.0
# A vibration that begins lifts all taxels alike, before it is known and taken out (drivers/pad/vibration.py).
COMMON_COUNTS = 8.0
COMMON_SHARE = 0.25


class LightContact:
    """Contact of which it is not clear yet whether it is a touch.

    since: its first frame. last: its latest frame above the threshold. moved, highest: the most movement and
    contact, in counts summed over the pad.
    """

    def __init__(self, index: int, smooth: Taxels) -> None:
        self.since = self.last = index
        self.moved = self.highest = 0.0
        self._touched: NDArray[np.bool_] = np.zeros(TAXELS, np.bool_)
        self._before = smooth

    def follow(
        self,
        index: int,
        smooth: Taxels,
        above: Taxels,
        contact: float,
        onset_counts: float,
        baseline: Baseline,
    ) -> None:
        """Take the next frame: (64,) counts, what of them is above the noise floor, and its contact."""
        if index - self.since <= STEP_FRAMES:
            self._before = smooth
        if contact >= onset_counts:
            self.last, self._touched = index, above > 0
        self.highest = max(self.highest, contact)
        off = smooth - self._before
        off -= np.sort(off)[TAXELS // 2]
        moved = np.maximum(np.abs(off) - baseline.noise_floor, 0)
        self.moved = max(self.moved, float(moved.sum()))

    def began(self, index: int, recent: LastSecond, baseline: Baseline) -> int:
        """Return the first frame of the unbroken run up to the contact with its taxels above rest."""
        rest = baseline.counts[self._touched].mean()
        before = recent.last(SECOND_FRAMES)[: self.since - index - 1, self._touched]
        above = before.mean(axis=1) - rest >= BACKDATE_COUNTS
        return self.since - (len(above) if above.all() else int(above[::-1].argmin()))


def is_in_common(rise: Taxels) -> bool:
    """Whether all taxels are above rest alike, as no hand lifts them."""
    lifted = np.sort(rise)
    return bool(lifted[TAXELS // 2] >= COMMON_SHARE * lifted[-1] and lifted[-1] <= COMMON_COUNTS)


def beyond_one_wire(above: NDArray[np.float32]) -> list[float]:
    """Sum each of (N, 64) counts, less the strongest row or column up to what a loose wire lifts."""
    grids = above.reshape(-1, ROWS, COLUMNS)
    lines = zip(np.add.reduce(grids, axis=2).tolist(), np.add.reduce(grids, axis=1).tolist(), strict=True)
    return [sum(rows) - min(max(*rows, *columns), WIRE_COUNTS) for rows, columns in lines]
