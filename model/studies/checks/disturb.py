"""Disturbances of windows of counts, as by another pad, lab or hand, to measure how robust accuracy is."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import FRAME_RATE_HZ, MAX_COUNT

Counts32 = NDArray[np.float32]
Times = NDArray[np.float64]
Disturb = Callable[[Counts32], Counts32]
"""Maps windows of counts (B, T, 8, 8) float32 to disturbed ones of the same shape."""

FULL = np.float32(MAX_COUNT)
SHIFT = ((0, 0), (0, 0), (1, 0), (1, 0))
"""Shifts the pad by one taxel along both axes; the new edge repeats the old one."""
LOST_SHARE = 0.05
REST_COUNTS = 2.0
RISE_FRAMES = 4
DEAD_ROW = 3
BREATHS_HZ = 0.5
BREATH_COUNTS = 4.0
LEFT_COUNTS = 5.0
BEND = 0.9
"""Half the angle of a curved pad, in radians."""


def half_pressure(counts: Counts32) -> Counts32:
    """Halve the pressure of the hand, but not the pad's rest level."""
    rest = np.minimum(counts, np.float32(REST_COUNTS))
    return np.asarray(rest + (counts - rest) / 2)


def rest_shifted(counts: Counts32) -> Counts32:
    """Add 5 counts where the previous window pressed most, as fabric that does not spring back."""
    before = np.roll(counts, 1, axis=0).mean(axis=1, keepdims=True)  # (B, 1, 8, 8)
    pressed = before > np.median(before, axis=(2, 3), keepdims=True)
    return np.asarray(np.minimum(counts + np.float32(LEFT_COUNTS) * pressed, FULL))


def breathing(counts: Counts32) -> Counts32:
    """Flex the pad at 0.5 Hz: one end rises by up to 4 counts while the other falls."""
    seconds = np.arange(counts.shape[1], dtype=np.float32)[:, None, None] / np.float32(FRAME_RATE_HZ)
    slope = np.linspace(-1.0, 1.0, counts.shape[2], dtype=np.float32)[:, None]
    breath = np.float32(BREATH_COUNTS) * np.sin(2 * np.pi * BREATHS_HZ * seconds) * slope
    return np.asarray(np.clip(counts + breath, 0, MAX_COUNT), dtype=np.float32)


def curved(counts: Counts32) -> Counts32:
    """Bend the pad around a cylinder: touches near its edges are foreshortened and press less."""
    columns = counts.shape[3]
    angles = BEND * np.linspace(-1.0, 1.0, columns)
    places = (np.sin(angles) / np.sin(BEND) + 1) / 2 * (columns - 1)
    left = np.clip(places.astype(np.int64), 0, columns - 2)
    part = (places - left).astype(np.float32)
    seen = counts[..., left] * (1 - part) + counts[..., left + 1] * part
    return np.asarray(seen * np.cos(angles), dtype=np.float32)


def dead_row(counts: Counts32) -> Counts32:
    """Let one row of taxels read zero."""
    broken: Counts32 = counts.copy()
    broken[:, :, DEAD_ROW] = 0
    return broken


def from_rest(counts: Counts32) -> Counts32:
    """Begin from rest and rise over 75 ms, as live touches do; HAART's recordings are cut mid-gesture."""
    contact = np.minimum(np.arange(counts.shape[1], dtype=np.float32) / RISE_FRAMES, 1.0)[:, None, None]
    return np.asarray(counts * contact + np.float32(REST_COUNTS) * (1.0 - contact))


def lossy(counts: Counts32) -> Counts32:
    """Lose 5 % of the frames, but not the first and last, and interpolate linearly, as the ring does."""
    rng = np.random.default_rng(0)
    grid = np.arange(counts.shape[1], dtype=np.float64)
    bridged = []
    for window in counts:
        lost = np.asarray(rng.random(len(grid))) < LOST_SHARE
        lost[0] = lost[-1] = False
        bridged.append(_resample(window[~lost], grid[~lost], grid))
    return np.stack(bridged)


def pad_rate(rate_hz: float) -> Disturb:
    """Return the disturbance of a pad that scans at another rate, interpolated linearly to 54 Hz."""

    def disturb(counts: Counts32) -> Counts32:
        grid = np.arange(counts.shape[1], dtype=np.float64)
        scans = np.arange(0.0, len(grid) - 1 + 1e-9, FRAME_RATE_HZ / rate_hz)
        return np.stack([_resample(_resample(window, grid, scans), scans, grid) for window in counts])

    return disturb


def _resample(frames: Counts32, times: Times, at: Times) -> Counts32:
    """Interpolate frames (N, 8, 8) linearly from their times (N,) to other times."""
    right = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    left = right - 1
    part = np.clip((at - times[left]) / (times[right] - times[left]), 0.0, 1.0)
    weight = part.astype(np.float32)[:, None, None]
    return np.asarray(frames[left] * (1 - weight) + frames[right] * weight)


DISTURBANCES: Mapping[str, Disturb] = {
    "none": lambda counts: counts,
    "begun from rest": from_rest,
    "counts x 0.5": lambda counts: np.minimum(counts * np.float32(0.5), FULL),
    "counts x 2": lambda counts: np.minimum(counts * np.float32(2.0), FULL),
    "half the pressure": half_pressure,
    "+ 10 counts": lambda counts: np.minimum(counts + np.float32(10.0), FULL),
    "quarter turn": lambda counts: np.rot90(counts, axes=(2, 3)).copy(),
    "mirror": lambda counts: counts[..., ::-1].copy(),
    "shift by one taxel": lambda counts: np.pad(counts, SHIFT, mode="edge")[:, :, :-1, :-1],
    "curved pad": curved,
    "breathing pad": breathing,
    "rest shifted by 5 counts after each touch": rest_shifted,
    "one dead row": dead_row,
    "5 % of frames lost": lossy,
    "50 Hz pad": pad_rate(50.0),
    "60 Hz pad": pad_rate(60.0),
}
