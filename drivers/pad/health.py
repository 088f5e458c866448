"""What a pad's own values say about the pad: wires that broke, a short, a rest level that creeps up.

The fabric pad is never still: in all of HAART's recordings, at rest and under hands, each of the 64 taxels
changes at least every 2 s, and none reads above 972. So a taxel that stands still is broken, not merely
untouched. Pads that are silent at rest exist too; on those stillness means nothing and is not reported.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import CLOCK_MODULUS, COLUMNS, ROWS, Counts, Frame

Kind = Literal["frozen", "dead line", "stuck taxel", "saturated", "drift"]

# The share of frames, averaged over 2 s, in which a taxel changes: mostly above one half on a sound pad.
# From there it takes a taxel about 8 s to count as still, and half a second to count as lively again.
AVERAGE_S = 2.0
# Frames are checked half a second at a time, which takes a twentieth of the time of one by one.
BLOCK_FRAMES = 27
STILL_SHARE = 0.01
UNKNOWN_SHARE = 0.05
LIVELY_SHARE = 0.1
# A pad of which so many taxels change at once has noise, and stillness on it means something.
LIVELY_TAXELS = 48
SATURATED_COUNT = 1000
SATURATED_TAXELS = 16
# The level under every touch: no touch lasts a minute without a gap.
REST_BLOCK_S = 10.0
REST_BLOCKS = 6
DRIFT_COUNTS = 10.0
# Taxels of one broken wire do not fall still in the same frame; report once all have.
SETTLE_S = 2.0


@dataclass(frozen=True)
class Finding:
    """Something is wrong with the pad since now (began), or no longer is; `what` is for a person."""

    kind: Kind
    what: str
    began: bool


class PadHealth:
    """Watches frames for a pad that is broken; each kind of trouble is told once when it begins and ends.

    told: the troubles that have begun and not ended, in words.
    """

    def __init__(self) -> None:
        self._block: list[Frame] = []
        self._clock_s = 0.0
        self._activity = np.full((ROWS, COLUMNS), UNKNOWN_SHARE)
        self._is_still = np.zeros((ROWS, COLUMNS), dtype=np.bool_)
        self._has_noise = False
        self._saturation = 0.0
        self._rest = _RestLevel()
        self.told: dict[Kind, str] = {}
        self._changing_since_s: dict[Kind, float] = {}

    def update(self, frame: Frame) -> Finding | None:
        """Take the next frame; return the finding that begins or ends with it, at most one a block."""
        self._block.append(frame)
        if len(self._block) <= BLOCK_FRAMES:
            return None
        self._measure(np.stack([one.pressure for one in self._block]), _passed_s(self._block))
        self._block = [frame]
        return self._next_change(self._troubles())

    def _measure(self, pressure: Counts, passed_s: float) -> None:
        """Take (T, 8, 8) frames, the first of which was taken before, and how long the others took."""
        self._clock_s += passed_s
        weight = 1.0 - math.exp(-passed_s / AVERAGE_S)
        changed = (pressure[1:] != pressure[:-1]).mean(axis=0)
        self._activity += weight * (changed - self._activity)
        is_still = self._activity < STILL_SHARE
        self._is_still = is_still | (self._is_still & (self._activity < LIVELY_SHARE))
        self._has_noise |= int((self._activity > LIVELY_SHARE).sum()) >= LIVELY_TAXELS
        is_saturated = (pressure[1:] >= SATURATED_COUNT).sum(axis=(1, 2)) >= SATURATED_TAXELS
        self._saturation += weight * (float(is_saturated.mean()) - self._saturation)
        self._rest.update(pressure[1:].min(axis=0), self._clock_s)

    def _troubles(self) -> dict[Kind, str]:
        """The current faults, in words."""
        troubles: dict[Kind, str] = {}
        if self._saturation > (0.5 if "saturated" in self.told else 0.9):
            troubles["saturated"] = "a quarter of the pad or more is at its limit: too heavy a load, a short?"
        elif self._has_noise and self._is_still.all():
            troubles["frozen"] = "frames arrive but no value changes: the pad is off its board, or it hangs"
        elif self._has_noise:
            troubles |= _still_parts(self._is_still)
        rise = self._rest.rise_counts
        if rise > (DRIFT_COUNTS / 2 if "drift" in self.told else DRIFT_COUNTS):
            troubles["drift"] = f"the level at rest rose by {rise:.0f} counts: drift, or something lies there"
        return troubles

    def _next_change(self, troubles: dict[Kind, str]) -> Finding | None:
        changing = sorted(troubles.keys() ^ self.told.keys())
        self._changing_since_s = {kind: self._changing_since_s.get(kind, self._clock_s) for kind in changing}
        for kind, since_s in self._changing_since_s.items():
            if self._clock_s - since_s < SETTLE_S:
                continue
            if kind in self.told:
                return Finding(kind, self.told.pop(kind), began=False)
            self.told[kind] = troubles[kind]
            return Finding(kind, troubles[kind], began=True)
        return None


class _RestLevel:
    """The lowest value of each taxel in the last minute, and how far it rose above the lowest minute yet."""

    def __init__(self) -> None:
        self._blocks: deque[Counts] = deque(maxlen=REST_BLOCKS)
        self._block_until_s = REST_BLOCK_S
        self._lowest: Counts | None = None
        self._reference: NDArray[np.float64] | None = None
        self.rise_counts = 0.0

    def update(self, pressure: Counts, clock_s: float) -> None:
        self._lowest = pressure if self._lowest is None else np.minimum(self._lowest, pressure)
        if clock_s < self._block_until_s:
            return
        self._block_until_s = clock_s + REST_BLOCK_S
        self._blocks.append(self._lowest)
        self._lowest = None
        if len(self._blocks) == REST_BLOCKS:
            level = np.min(np.stack(self._blocks), axis=0).astype(np.float64)
            self._reference = level if self._reference is None else np.minimum(self._reference, level)
            self.rise_counts = float((level - self._reference).mean())


def _passed_s(frames: Sequence[Frame]) -> float:
    """Return how long frames took by the pad's clock; 1 s where the clock jumped."""
    clock_ms = np.array([frame.sensor_ms for frame in frames], dtype=np.int64)
    return float(np.minimum(np.diff(clock_ms) % CLOCK_MODULUS / 1000, 1.0).sum())


def _still_parts(is_still: NDArray[np.bool_]) -> dict[Kind, str]:
    """Name the rows, columns and single taxels (counted from 1) of a mask (8, 8)."""
    rows: NDArray[np.bool_] = is_still.sum(axis=1) == COLUMNS
    columns: NDArray[np.bool_] = is_still.sum(axis=0) == ROWS
    parts: dict[Kind, str] = {}
    lines = [f"row {row + 1}" for row in np.flatnonzero(rows)]
    lines += [f"column {column + 1}" for column in np.flatnonzero(columns)]
    if lines:
        parts["dead line"] = f"{', '.join(lines)} of the pad stands still: a broken wire?"
    singles = np.argwhere(is_still & ~rows[:, None] & ~columns[None, :])
    if len(singles):
        places = ", ".join(f"row {row + 1} column {column + 1}" for row, column in singles[:4])
        more = f" and {len(singles) - 4} more" if len(singles) > 4 else ""
        parts["stuck taxel"] = f"the taxel at {places}{more} stands still"
    return parts
