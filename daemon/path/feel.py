"""Describes a touch from its frames: duration, pressure, area, path and rhythm."""

import cmath
import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS

# A taxel is touched if it rises by this many deviations of its noise and at least this many counts.
TOUCHED_DEVIATIONS, TOUCHED_COUNTS = 4.0, 4.0
# The centroid is smoothed by this share a frame (4 frames), so that noise adds no path.
CENTROID_SHARE = 0.25
# A beat rises from below the first to above the second share of the peak load.
FALLEN_SHARE, RISEN_SHARE = 0.15, 0.4
MOST_LOADS = round(60 * FRAME_RATE_HZ)

# (2, 64): the column and the row of each taxel.
PLACES = np.indices((ROWS, COLUMNS), np.float32)[::-1].reshape(2, -1)


class Feel(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Measures of a touch, which docs/events.md explains.

    direction_deg is None if the displacement is shorter than a taxel, path_mm and stroke_mm if the pad's size
    is not known.
    """

    duration_s: float
    peak: float
    mean: float
    area: float
    row: float
    column: float
    path: float
    down: float
    right: float
    rhythm_hz: float
    direction_deg: float | None = None
    path_mm: float | None = None
    stroke_mm: float | None = None


class FeelMeter:
    """Follows one touch frame by frame, in bounded memory.

    rest, noise: (64,) counts, the noise a deviation. size_mm: height and width of the 8x8 taxels.
    """

    def __init__(
        self, rest: NDArray[np.float32], noise: NDArray[np.float32], size_mm: tuple[float, float] | None
    ) -> None:
        self._rest = rest.copy()
        self._threshold = np.maximum(TOUCHED_DEVIATIONS * noise, TOUCHED_COUNTS)
        self._has_size = size_mm is not None
        height, width = size_mm or (0.0, 0.0)
        self._pitch_mm = (height / ROWS, width / COLUMNS)
        self._frames = self._last = self._touched_frames = 0
        self._peak = self._touched = self._pressed = self._path = self._path_mm = 0.0
        # Places are complex: column + row * 1j.
        self._place_sum = self._start = self._end = 0j
        self._place: complex | None = None
        self._loads: list[float] = []

    def add(self, pressure: NDArray[np.float32]) -> None:
        """Take the touch's next frame on the 54 Hz grid, (8, 8) counts."""
        rise = pressure.reshape(-1) - self._rest
        is_touched = rise >= self._threshold
        rise *= is_touched
        load = float(np.add.reduce(rise))
        if len(self._loads) < MOST_LOADS:
            self._loads.append(load)
        self._frames += 1
        if load == 0:
            return
        if self._last != self._frames - 1:
            # The hand was lifted: movement in the air does not count.
            self._place = None
        self._last = self._frames
        self._touched_frames += 1
        self._peak = max(self._peak, float(np.maximum.reduce(rise)))
        self._touched += int(np.count_nonzero(is_touched))
        self._pressed += load
        self._move(complex(*(PLACES @ rise).tolist()) / load)

    def feel(self) -> Feel:
        """Return the measures of the touch so far."""
        count = max(self._touched_frames, 1)
        place, way = self._place_sum / count, self._end - self._start
        return Feel(
            duration_s=round(self._last / FRAME_RATE_HZ, 3),
            peak=round(self._peak, 1),
            mean=round(self._pressed / max(self._touched, 1), 1),
            area=round(self._touched / count, 1),
            row=round(place.imag, 2),
            column=round(place.real, 2),
            path=round(self._path, 2),
            down=round(way.imag, 2),
            right=round(way.real, 2),
            direction_deg=round(math.degrees(cmath.phase(way.conjugate()))) if abs(way) >= 1 else None,
            rhythm_hz=round(self._rhythm_hz(), 2),
            path_mm=round(self._path_mm, 1) if self._has_size else None,
            stroke_mm=round(self._in_mm(way), 1) if self._has_size else None,
        )

    def _move(self, centroid: complex) -> None:
        self._place_sum += centroid
        if self._place is None:
            self._place = centroid
        step = CENTROID_SHARE * (centroid - self._place)
        self._place = self._end = self._place + step
        self._path += abs(step)
        self._path_mm += self._in_mm(step)
        if self._touched_frames == 1:
            self._start = self._place

    def _in_mm(self, way: complex) -> float:
        """Return the length of a displacement in mm; 0 if the pad's size is not known."""
        height, width = self._pitch_mm
        return math.hypot(way.real * width, way.imag * height)

    def _rhythm_hz(self) -> float:
        """Return the mean rate of beats, from the first to the last; 0 if there are fewer than two."""
        top = max(self._loads, default=0.0)
        beats, is_fallen = list[int](), True
        for at, load in enumerate(self._loads):
            if is_fallen and load > RISEN_SHARE * top:
                beats.append(at)
                is_fallen = False
            elif load < FALLEN_SHARE * top:
                is_fallen = True
        return FRAME_RATE_HZ * (len(beats) - 1) / (beats[-1] - beats[0]) if len(beats) > 1 else 0.0
