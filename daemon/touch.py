"""When a touch begins and when it ends.

Rest is learned per taxel and followed while nothing touches. Contact is pressure above rest and above the
taxel's own noise, summed over the pad: a light stroke is hardly above noise in any one taxel, but in many at
once. A loose wire lifts a whole row by a few counts, as a light touch does; a touch lifts other rows too, or
that one by more, so it begins on the contact beyond one row's or column's first counts. It ends when all
contact has been gone for `quiet_s`. A load that keeps still for `settled_s` is no hand, for a resting hand
trembles: it becomes the new rest. So does what lies below rest for half a second, as when a hand lifts that
lay on the pad while rest was learned. The figures behind the numbers are in docs/touch.md.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from daemon.events import EndReason
from drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS
from drivers.pad.grid import GridFrame

TAXELS = ROWS * COLUMNS
Taxels = NDArray[np.float32]

# A median over three frames halves the noise and lets no single broken frame through, for one frame's delay.
SMOOTH_FRAMES = 3
LEARN_FRAMES = 27
FOLLOW_FRAMES = 3.0 * FRAME_RATE_HZ
# Rest follows no faster than this many counts per FOLLOW_FRAMES, so that a light touch does not become rest.
FOLLOW_COUNTS = 1.0
FLOOR_COUNTS = 1.6
FLOOR_DEVIATIONS = 2.0
MAX_DEVIATION_COUNTS = 4.0
WIRE_COUNTS = 25.0
BACKDATE_COUNTS = 1.0
# A taxel keeps still within this many times its floor, 3.2 counts on a quiet pad.
STILL_FLOORS = 2.0
# A pad silent for longer, or restarted, may have been moved or changed: its rest is learned anew.
CHANGED_AFTER_MS = 2000.0


class TouchSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a touch is told from a pad at rest. The defaults were chosen by measurement: docs/touch.md.

    onset_level: contact that begins a touch, in counts summed over the pad above each taxel's noise; lower
        notices lighter touches and raises more false alarms.
    release_level: contact below which the pad is quiet, in the same counts.
    quiet_s: a touch ends after this much quiet; longer than the lift-off between two strokes. Seconds.
    settled_s: a load that has kept still for this long is taken for the pad's new rest. Seconds.
    """

    onset_level: Annotated[float, msgspec.Meta(gt=0, le=1000)] = 4.0
    release_level: Annotated[float, msgspec.Meta(gt=0, le=1000)] = 4.0
    quiet_s: Annotated[float, msgspec.Meta(ge=0.1, le=5.0)] = 0.8
    settled_s: Annotated[float, msgspec.Meta(ge=5, le=3600)] = 10.0

    def __post_init__(self) -> None:
        if self.release_level > self.onset_level:
            raise ValueError(f"release_level {self.release_level} is above onset_level {self.onset_level}")


@dataclass(frozen=True, slots=True)
class Onset:
    """A touch has been noticed; first_index is the grid frame at which it truly began."""

    first_index: int


@dataclass(frozen=True, slots=True)
class Release:
    """The touch is over; first_index and last_index are its first and last grid frame with contact."""

    first_index: int
    last_index: int
    reason: EndReason


class Rest:
    """What each taxel reads, and how much it strays, while nothing touches the pad."""

    def __init__(self) -> None:
        self.known = False
        self.counts = np.zeros(TAXELS, np.float32)
        self._deviation = np.zeros(TAXELS, np.float32)
        self.floor = np.full(TAXELS, FLOOR_COUNTS, np.float32)

    def learn(self, frames: NDArray[np.float32]) -> None:
        """Take (T, 64) counts for the pad at rest."""
        self.known = True
        # The median of an odd number; np.median would first import numpy.ma, which stalls the loop for 20 ms.
        self.counts = np.sort(frames, axis=0)[len(frames) // 2]
        self._deviation = np.abs(frames - self.counts).mean(axis=0, dtype=np.float32)
        self._set_floor()

    def follow(self, pressure: Taxels) -> None:
        """Drift a little towards (64,) counts of a pad that nothing touches."""
        off = pressure - self.counts
        self.counts += np.maximum(np.minimum(off, FOLLOW_COUNTS), -FOLLOW_COUNTS) / FOLLOW_FRAMES
        self._deviation += (np.abs(off) - self._deviation) / FOLLOW_FRAMES
        self._set_floor()

    def _set_floor(self) -> None:
        np.minimum(self._deviation, MAX_DEVIATION_COUNTS, out=self._deviation)
        self.floor = np.maximum(self._deviation * FLOOR_DEVIATIONS, FLOOR_COUNTS)


class TouchTracker:
    """Follows the pad frame by frame and says when a touch begins and ends.

    before: a tracker that this one goes on from between two touches, by other settings.
    """

    def __init__(self, settings: TouchSettings, before: TouchTracker | None = None) -> None:
        self._rest = Rest()
        self._recent: deque[Taxels] = deque(maxlen=LEARN_FRAMES)
        self._index = -1
        self._sensor_ms = 0.0
        self._sunken_frames = 0
        self._first_index: int | None = None
        self._last_index = 0
        self._still = self._rest.counts
        self._still_since = 0
        if before is not None:
            vars(self).update(vars(before))
        self._settings = settings
        self._quiet_frames = round(settings.quiet_s * FRAME_RATE_HZ)
        self._settled_frames = round(settings.settled_s * FRAME_RATE_HZ)

    @property
    def rest(self) -> Rest:
        """What is known of the pad at rest; it stays the same during a touch."""
        return self._rest

    @property
    def last_contact_index(self) -> int:
        """The last grid frame with contact of the touch that goes on; the median shows its end late."""
        if self._last_index == self._index or self._first_index is None:
            return self._last_index
        return max(self._first_index, self._last_index - SMOOTH_FRAMES // 2)

    def update(self, frame: GridFrame) -> Onset | Release | None:
        """Take the next grid frame; return what it changed. The first half second is learned as rest."""
        release = None
        if frame.restarted:
            release = self._end("gap")
            self._recent.clear()
            self._sunken_frames = 0
            if not 0 < frame.sensor_ms - self._sensor_ms <= CHANGED_AFTER_MS:
                self._rest = Rest()
        self._index, self._sensor_ms = frame.index, frame.sensor_ms
        self._recent.append(frame.pressure.reshape(TAXELS))
        if not self._rest.known:
            if len(self._recent) == LEARN_FRAMES:
                self._learn_rest()
            return release
        if len(self._recent) < SMOOTH_FRAMES:
            return release
        smooth = _median(self._recent[-1], self._recent[-2], self._recent[-3])
        if self._first_index is None:
            return self._watch(smooth)
        return self._hold(smooth)

    def forget(self, reason: EndReason) -> Release | None:
        """End the touch, if one goes on, and learn rest anew from what comes: it may be another pad."""
        release = self._end(reason)
        self._rest = Rest()
        self._recent.clear()
        return release

    def _watch(self, smooth: Taxels) -> Onset | None:
        rise = smooth - self._rest.counts
        above = np.maximum(rise - self._rest.floor, 0)
        if _beyond_one_wire(above) >= self._settings.onset_level:
            self._first_index = self._backdate(above > 0)
            self._last_index = self._index
            self._still, self._still_since = smooth, self._index
            return Onset(self._first_index)
        self._rest.follow(self._recent[-1])
        below = np.maximum(-rise - self._rest.floor, 0)
        sunken = _beyond_one_wire(below) >= self._settings.onset_level
        self._sunken_frames = self._sunken_frames + 1 if sunken else 0
        if self._sunken_frames >= LEARN_FRAMES:
            # Pressure does not go below rest: rest was learned under a hand or an object that is now gone.
            self._learn_rest()
        return None

    def _hold(self, smooth: Taxels) -> Release | None:
        contact = float(np.maximum(smooth - self._rest.counts - self._rest.floor, 0).sum())
        if contact >= self._settings.release_level:
            self._last_index = self._index
        elif self._index - self._last_index >= self._quiet_frames:
            return self._end("released")
        if (np.abs(smooth - self._still) > STILL_FLOORS * self._rest.floor).any():
            self._still, self._still_since = smooth, self._index
        elif self._index - self._still_since >= self._settled_frames:
            self._learn_rest()
            return self._end("settled")
        return None

    def _backdate(self, touched: NDArray[np.bool_]) -> int:
        """Return the first frame of the unbroken run up to now in which these taxels were above rest."""
        rest = self._rest.counts[touched].mean()
        frames = 1
        for pressure in list(self._recent)[-2::-1]:
            if pressure[touched].mean() - rest < BACKDATE_COUNTS:
                break
            frames += 1
        return self._index - frames + 1

    def _learn_rest(self) -> None:
        self._rest.learn(np.stack(self._recent))
        self._sunken_frames = 0

    def _end(self, reason: EndReason) -> Release | None:
        if self._first_index is None:
            return None
        release = Release(self._first_index, self.last_contact_index, reason)
        self._first_index = None
        return release


def _median(a: Taxels, b: Taxels, c: Taxels) -> Taxels:
    median: Taxels = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
    return median


def _beyond_one_wire(above: Taxels) -> float:
    """Return the (64,) counts summed, less the strongest row or column up to what a loose wire lifts."""
    grid = above.reshape(ROWS, COLUMNS)
    rows = np.add.reduce(grid, axis=1)
    wire = max(float(rows.max()), float(np.add.reduce(grid, axis=0).max()))
    return float(rows.sum()) - min(wire, WIRE_COUNTS)
