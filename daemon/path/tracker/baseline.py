"""The untouched pad: what each taxel reads, how much it varies, and the last second of frames."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS

TAXELS = ROWS * COLUMNS
Taxels = NDArray[np.float32]
SECOND_FRAMES = 54

# Time constant of the baseline, three seconds: a light touch of a second moves it by a third of a count.
TRACK_FRAMES = 3.0 * FRAME_RATE_HZ
# Noise floor: two mean deviations, at least 1.6 counts, the mean floor of HAART's pad at rest.
NOISE_DEVIATIONS = 2.0
MIN_NOISE_FLOOR = 1.6
# The most noise, and the most sway, that an untouched pad may have.
MAX_DEVIATION_COUNTS = 4.0
# White noise steps from frame to frame by the square root of two times its deviation.
STEP_NOISE = 0.7
# The noise floor is at least this many times the slow sway of a body that breathes; with 1, 1 % more of its
# touches are merged.
SWAY_FLOOR = 1.3
# Noise is the mean change of a taxel over this many frames. Over one frame, slow hum looks like rest; over
# three, a slow press adds hardly anything.
NOISE_FRAMES = 3
# The learned sway halves in 23 seconds, at six checks a second.
SWAY_KEPT = 0.995
# Mean noise floor above which light touches go unnoticed. HAART's pad has 1.6, the robot's 2.0 at most.
DISTURBED_FLOOR = 2.2


class Baseline:
    """What each taxel reads at rest, and how much it varies.

    counts: (64,) readings at rest. noise_floor: (64,) counts above them that are noise. sway: (64,) the
    largest recent change from one half second to the next.
    """

    def __init__(self) -> None:
        self.counts = np.zeros(TAXELS, np.float32)
        self.noise_floor = np.full(TAXELS, MIN_NOISE_FLOOR, np.float32)
        self.sway = np.zeros(TAXELS, np.float32)
        self._deviation = np.zeros(TAXELS, np.float32)
        self._steps = np.zeros(TAXELS, np.float32)
        self._latest: deque[Taxels] = deque(maxlen=NOISE_FRAMES)
        self._least_floor = self.noise_floor

    def calibrate(self, frames: NDArray[np.float32]) -> None:
        """Take (T, 64) counts as the untouched pad."""
        self.shift(frames)
        self._deviation = np.abs(frames - self.counts).mean(axis=0, dtype=np.float32)
        self._steps = np.abs(frames[1:] - frames[:-1]).mean(axis=0, dtype=np.float32)
        self._set_noise_floor()

    def shift(self, frames: NDArray[np.float32]) -> None:
        """Take (T, 64) counts as the untouched pad, whose noise stays as it was."""
        # The median, for an odd number; np.median would import numpy.ma, which stalls the loop for 20 ms.
        self.counts = np.sort(frames, axis=0)[len(frames) // 2]

    def track(self, pressure: Taxels) -> None:
        """Move slowly towards (64,) counts of an untouched pad."""
        # At most by one count a time constant, so that an undetected touch does not become rest.
        self.counts += np.minimum(np.maximum(pressure - self.counts, -1), 1) / TRACK_FRAMES
        if self._latest:
            moved, before = np.abs(pressure - self._latest[-1]), np.abs(pressure - self._latest[0])
            self._steps += (moved - self._steps) / TRACK_FRAMES
            self._deviation += (STEP_NOISE * before - self._deviation) / TRACK_FRAMES
        self._set_noise_floor()
        self._latest.append(pressure.copy())

    @property
    def is_disturbed(self) -> bool:
        """Whether the pad is so noisy, not counting its sway, that light touches go unnoticed."""
        noise_floor = np.maximum(self._steps * (STEP_NOISE * NOISE_DEVIATIONS), MIN_NOISE_FLOOR)
        return float(noise_floor.mean()) >= DISTURBED_FLOOR

    def track_sway(self, change: Taxels) -> None:
        """Take the (64,) counts by which an untouched pad moved from one half second to the next."""
        self.sway = np.maximum(self.sway * SWAY_KEPT, np.minimum(change, MAX_DEVIATION_COUNTS))
        self._least_floor = np.maximum(self.sway * SWAY_FLOOR, MIN_NOISE_FLOOR)

    def _set_noise_floor(self) -> None:
        np.minimum(self._deviation, MAX_DEVIATION_COUNTS, out=self._deviation)
        self.noise_floor = np.maximum(self._deviation * NOISE_DEVIATIONS, self._least_floor)


class LastSecond:
    """The newest frames, (64,) counts each, at most a second of them."""

    def __init__(self) -> None:
        self._frames = np.zeros((2 * SECOND_FRAMES, TAXELS), np.float32)
        self._pushed = 0

    def __len__(self) -> int:
        return min(self._pushed, SECOND_FRAMES)

    def push(self, pressure: Taxels) -> None:
        place = self._pushed % SECOND_FRAMES
        # Written twice, so that the newest frames always lie side by side.
        self._frames[place] = self._frames[place + SECOND_FRAMES] = pressure
        self._pushed += 1

    def clear(self) -> None:
        self._pushed = 0

    def last(self, frames: int) -> NDArray[np.float32]:
        """Return the newest frames, oldest first, as a view (frames, 64); at most as many as there are."""
        stop = (self._pushed - 1) % SECOND_FRAMES + SECOND_FRAMES + 1
        return self._frames[stop - min(frames, len(self)) : stop]

    def halves(self) -> tuple[Taxels, Taxels]:
        """Return each taxel's mean in the older and in the newer half second."""
        frames = self.last(SECOND_FRAMES).reshape(2, -1, TAXELS)
        older, newer = np.add.reduce(frames, axis=1) * (2 / SECOND_FRAMES)
        return older, newer

    def spread(self) -> Taxels:
        """Return each taxel's standard deviation within the two halves."""
        frames = self.last(SECOND_FRAMES).reshape(2, -1, TAXELS)
        deviation: Taxels = np.sqrt(frames.var(axis=1).mean(axis=0))
        return deviation
