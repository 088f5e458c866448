"""The pace of received frames by the pad's clock: steps, rate, jitter, lost frames."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import CLOCK_MODULUS, Frame
from touchd.drivers.pad.grid import LOST_STEP

# In less time, two clocks cannot be compared.
COMPARABLE_S = 1.5


@dataclass(frozen=True)
class Pace:
    """Frames a second, the standard deviation of the steps between them, and lost frames.

    Steps with a lost frame count for neither rate nor jitter.
    """

    rate_hz: float
    jitter_ms: float
    lost: int

    def __str__(self) -> str:
        return f"{self.rate_hz:.2f} Hz, {self.lost} frames lost"


def steps_ms(frames: Sequence[Frame]) -> NDArray[np.int64]:
    """Return the steps between T frames by the pad's clock, (T - 1,) ms; the clock may wrap."""
    stamps = np.array([frame.sensor_ms for frame in frames], dtype=np.int64)
    steps: NDArray[np.int64] = np.diff(stamps) % CLOCK_MODULUS
    # The clock runs back when the pad was reset.
    steps[steps > CLOCK_MODULUS // 2] = 0
    return steps


def clock_ms(frames: Sequence[Frame]) -> NDArray[np.int64]:
    """Return the pad's clock at T frames, (T,) ms, unwrapped."""
    clock: NDArray[np.int64] = frames[0].sensor_ms + np.concatenate([[0], np.cumsum(steps_ms(frames))])
    return clock


def pace_of(frames: Sequence[Frame]) -> Pace:
    """Return the pace of two frames or more."""
    steps = steps_ms(frames)
    usual_ms = float(np.median(steps))
    is_whole = steps < LOST_STEP * usual_ms
    # If frames without a clock arrive in bursts, the steps do not show whether any is lost.
    if usual_ms < 1 or steps[is_whole].std() > usual_ms / 4:
        is_whole[:] = True
    lost = int(np.rint(steps[~is_whole] / usual_ms - 1).sum())
    return Pace(1000.0 / max(float(steps[is_whole].mean()), 0.001), float(steps[is_whole].std()), lost)


def relative_clock(frames: Sequence[Frame]) -> float:
    """Return the rate of the pad's clock relative to ours; 1 if the frames span less than COMPARABLE_S."""
    since_s = np.array([frame.host_s - frames[0].host_s for frame in frames])
    if since_s[-1] < COMPARABLE_S:
        return 1.0
    # Fit a line to all frames, so that one late frame does not matter.
    slope, _ = np.polyfit(since_s, clock_ms(frames) / 1000, 1)
    return float(slope)
