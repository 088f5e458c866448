"""Recordings of any pad laid on the model's 54 Hz grid, as the daemon's ring lays what a pad sends."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS
from drivers.recording import Recording, ideal_clock_ms

PERIOD_MS = 1000.0 / FRAME_RATE_HZ
# As in the ring: a pad in step with the grid is taken as it is, since interpolating would only blur it.
IN_STEP_SHARE = 0.01
LOST_MS = 1.75 * PERIOD_MS
# What the ring bridges unless it is told otherwise.
LONGEST_GAP_MS = 150.0


def on_grid(recording: Recording) -> Recording:
    """Return the recording's longest stretch without a gap, at 54 frames a second.

    A gap is more than 150 ms without a frame, or a clock that does not go on. Another rate, or a few lost
    frames, are interpolated linearly between neighbouring frames.
    """
    stretch = _longest_stretch(recording.sensor_ms)
    counts, clock_ms = recording.counts[stretch], recording.sensor_ms[stretch]
    if not _is_in_step(clock_ms):
        counts = _interpolated(counts.reshape(-1, ROWS * COLUMNS), clock_ms - clock_ms[0])
    return replace(recording, counts=counts, sensor_ms=ideal_clock_ms(len(counts)))


def _longest_stretch(clock_ms: NDArray[np.int64]) -> slice:
    steps = np.diff(clock_ms)
    cuts = np.flatnonzero((steps <= 0) | (steps > LONGEST_GAP_MS)) + 1
    edges = [0, *cuts.tolist(), len(clock_ms)]
    start, stop = max(pairwise(edges), key=lambda edge: edge[1] - edge[0])
    return slice(start, stop)


def _is_in_step(clock_ms: NDArray[np.int64]) -> bool:
    steps = np.diff(clock_ms)
    if not len(steps):
        return True
    return abs(float(steps.mean()) / PERIOD_MS - 1.0) <= IN_STEP_SHARE and float(steps.max()) <= LOST_MS


def _interpolated(taxels: NDArray[np.uint16], clock_ms: NDArray[np.int64]) -> NDArray[np.uint16]:
    """Return counts (T, 8, 8) every 1/54 s from counts (N, 64) at clock_ms (N,), which begins at 0."""
    at_ms = np.arange(0.0, float(clock_ms[-1]) + 1e-6, PERIOD_MS)
    columns = [np.interp(at_ms, clock_ms, taxels[:, taxel]) for taxel in range(taxels.shape[1])]
    counts: NDArray[np.uint16] = np.rint(np.stack(columns, axis=1)).astype(np.uint16)
    return counts.reshape(-1, ROWS, COLUMNS)
