"""Disturbances of a window of counts by a pad, a lab or a hand, to measure how robust accuracy is."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from drivers.frame import FRAME_RATE_HZ, MAX_COUNT

Counts32 = NDArray[np.float32]
Places = NDArray[np.float64]
Disturb = Callable[[Counts32], Counts32]
"""Maps windows of counts (B, T, 8, 8) float32 to disturbed ones of the same shape."""

LOST_SHARE = 0.05
REST_COUNTS = 2.0
RISE_FRAMES = 4
DEAD_ROW = 3
BREATHS_HZ = 0.5
BREATH_COUNTS = 4.0
LEFT_COUNTS = 5.0
BEND = 0.9
"""Half the angle, in radians, over which a curved pad is bent."""


def scaled(factor: float) -> Disturb:
    """Every count times a factor, saturating as the sensor does."""

    def disturb(counts: Counts32) -> Counts32:
        disturbed: Counts32 = np.minimum(counts * np.float32(factor), np.float32(MAX_COUNT))
        return disturbed

    return disturb


def offset(by: float) -> Disturb:
    """Every count raised, as after a change of temperature or cover."""

    def disturb(counts: Counts32) -> Counts32:
        disturbed: Counts32 = np.minimum(counts + np.float32(by), np.float32(MAX_COUNT))
        return disturbed

    return disturb


def half_pressure(counts: Counts32) -> Counts32:
    """Halve the pressure that a hand adds, not the rest level of a few counts."""
    rest = np.minimum(counts, np.float32(REST_COUNTS))
    disturbed: Counts32 = rest + (counts - rest) / 2
    return disturbed


def rest_shifted(counts: Counts32) -> Counts32:
    """Leave 5 counts where the touch before, here the window before, pressed more than on half of the pad."""
    before = np.roll(counts, 1, axis=0).mean(axis=1, keepdims=True)  # (B, 1, 8, 8)
    pressed = before > np.median(before, axis=(2, 3), keepdims=True)
    disturbed: Counts32 = np.minimum(counts + np.float32(LEFT_COUNTS) * pressed, np.float32(MAX_COUNT))
    return disturbed


def breathing(counts: Counts32) -> Counts32:
    """Flex the pad at 0.5 Hz: one end rises by up to 4 counts as the other falls."""
    seconds = np.arange(counts.shape[1], dtype=np.float32)[:, None, None] / np.float32(FRAME_RATE_HZ)
    slope = np.linspace(-1.0, 1.0, counts.shape[2], dtype=np.float32)[:, None]
    breath = np.float32(BREATH_COUNTS) * np.sin(2 * np.pi * BREATHS_HZ * seconds) * slope
    disturbed: Counts32 = np.clip(counts + breath, 0, MAX_COUNT).astype(np.float32)
    return disturbed


def curved(counts: Counts32) -> Counts32:
    """Bend the pad around a cylinder: a touch near its edges is foreshortened and presses less."""
    columns = counts.shape[3]
    angles = BEND * np.linspace(-1.0, 1.0, columns)
    places = (np.sin(angles) / np.sin(BEND) + 1) / 2 * (columns - 1)
    left = np.clip(places.astype(np.int64), 0, columns - 2)
    part = (places - left).astype(np.float32)
    seen = counts[..., left] * (1 - part) + counts[..., left + 1] * part
    disturbed: Counts32 = (seen * np.cos(angles)).astype(np.float32)
    return disturbed


def quarter_turn(counts: Counts32) -> Counts32:
    """Turn the pad by 90 degrees."""
    disturbed: Counts32 = np.rot90(counts, axes=(2, 3)).copy()
    return disturbed


def mirrored(counts: Counts32) -> Counts32:
    """Mirror the pad, as when it is mounted face down."""
    disturbed: Counts32 = counts[..., ::-1].copy()
    return disturbed


def shifted(counts: Counts32) -> Counts32:
    """Move the touch by one taxel along both axes; the edge that comes in repeats the old one."""
    moved: Counts32 = np.pad(counts, ((0, 0), (0, 0), (1, 0), (1, 0)), mode="edge")[:, :, :-1, :-1]
    return moved


def dead_row(counts: Counts32) -> Counts32:
    """One row of taxels reads zero."""
    broken: Counts32 = counts.copy()
    broken[:, :, DEAD_ROW] = 0
    return broken


def from_rest(counts: Counts32) -> Counts32:
    """Let the touch begin from rest and rise over 75 ms, as a live one does; HAART's are cut mid-gesture."""
    contact = np.minimum(np.arange(counts.shape[1], dtype=np.float32) / RISE_FRAMES, 1.0)[:, None, None]
    risen: Counts32 = counts * contact + np.float32(REST_COUNTS) * (1.0 - contact)
    return risen


def lossy(counts: Counts32) -> Counts32:
    """Lose 5 % of the frames (never the first or last) and bridge them as the ring does, linearly."""
    rng = np.random.default_rng(0)
    bridged: Counts32 = counts.copy()
    length = counts.shape[1]
    grid = np.arange(length, dtype=np.float64)
    for window in range(len(counts)):
        lost = np.asarray(rng.random(length)) < LOST_SHARE
        lost[0] = lost[-1] = False
        kept = np.flatnonzero(~lost)
        bridged[window] = _resample(counts[window][kept], grid[kept], grid)
    return bridged


def pad_rate(rate_hz: float) -> Disturb:
    """A pad that scans at another rate, resampled to 54 Hz by linear interpolation."""

    def disturb(counts: Counts32) -> Counts32:
        length = counts.shape[1]
        grid = np.arange(length, dtype=np.float64)
        scans = np.arange(0.0, length - 1 + 1e-9, FRAME_RATE_HZ / rate_hz)
        disturbed: Counts32 = np.empty_like(counts)
        for window in range(len(counts)):
            scanned = _resample(counts[window], grid, scans)
            disturbed[window] = _resample(scanned, scans, grid)
        return disturbed

    return disturb


def _resample(frames: Counts32, places: Places, wanted: Places) -> Counts32:
    """Interpolate frames (N, 8, 8) from their places (N,) linearly to the wanted places."""
    right = np.clip(np.searchsorted(places, wanted), 1, len(places) - 1)
    left = right - 1
    part = np.clip((wanted - places[left]) / (places[right] - places[left]), 0.0, 1.0)
    weight = part.astype(np.float32)[:, None, None]
    resampled: Counts32 = frames[left] * (1 - weight) + frames[right] * weight
    return resampled


DISTURBANCES: Mapping[str, Disturb] = {
    "none": lambda counts: counts,
    "begun from rest": from_rest,
    "counts x 0.5": scaled(0.5),
    "counts x 2": scaled(2.0),
    "half the pressure": half_pressure,
    "+ 10 counts": offset(10.0),
    "quarter turn": quarter_turn,
    "mirror": mirrored,
    "shift by one taxel": shifted,
    "curved pad": curved,
    "breathing pad": breathing,
    "rest shifted by 5 counts after each touch": rest_shifted,
    "one dead row": dead_row,
    "5 % of frames lost": lossy,
    "50 Hz pad": pad_rate(50.0),
    "60 Hz pad": pad_rate(60.0),
}
