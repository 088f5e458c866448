"""A simulated pad: what HAART's fabric sends at rest and under pressure."""

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, MAX_COUNT, ROWS, Counts

# Measured on HAART at rest and under load: noise per taxel and frame, spread of the taxels' sensitivity (as a
# logarithm), and the share of a row's pressure that leaks to each of its taxels.
NOISE_COUNTS = 0.75
UNEVENNESS = 0.35
ROW_LEAK = 0.02


class Fabric:
    """One pad, with a rest level and a sensitivity for each taxel.

    cells: rows and columns. full_scale: its largest value.
    """

    def __init__(
        self, rng: RandomState, cells: tuple[int, int] = (ROWS, COLUMNS), full_scale: int = MAX_COUNT
    ) -> None:
        rows, self._columns = cells
        self._rng = rng
        self._full_scale = full_scale
        self._rest = rng.gamma(2.0, 1.0, (rows, 1)) + rng.uniform(-0.5, 0.5, cells)
        self._sensitivity = rng.lognormal(0.0, UNEVENNESS, cells)

    def read(self, pressed: NDArray[np.float64]) -> Counts:
        """Return the pad's counts under a pressure (..., rows, columns), uint16, up to the full scale."""
        loaded = pressed * self._sensitivity
        leak = ROW_LEAK * loaded.sum(axis=-1, keepdims=True) * (COLUMNS / self._columns)
        noise = NOISE_COUNTS * self._rng.normal(size=pressed.shape)
        sent = (self._rest + loaded + leak + noise) * (self._full_scale / MAX_COUNT)
        counts: Counts = np.rint(sent).clip(0, self._full_scale).astype(np.uint16)
        return counts
