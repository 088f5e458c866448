"""A simulated pad at rest and a hand's pressure on it, with the noise of HAART's pad."""

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import Counts

Scans = NDArray[np.float32]
NOISE_COUNTS = 0.76


class MadePad:
    """A pad with a rest of a few counts per taxel."""

    def __init__(self, seed: int = 0) -> None:
        self.rest = np.random.default_rng(seed).integers(0, 6, (8, 8)).astype(np.float64)
        self._rng = np.random.default_rng(seed + 1)

    def counts(self, pressure: Scans) -> Counts:
        """Return (T, 8, 8) counts for (T, 8, 8) pressure above rest."""
        noisy = self.rest + pressure + self._rng.normal(0, NOISE_COUNTS, pressure.shape)
        return np.clip(np.rint(noisy), 0, 1023).astype(np.uint16)


def nothing(seconds: float) -> Scans:
    return np.zeros((round(seconds * 54), 8, 8), np.float32)


def palm(seconds: float, counts: float = 12.0, trembling: bool = True) -> Scans:
    """A hand resting on nine taxels."""
    scans = nothing(seconds)
    scans[:, 2:5, 3:6] = counts
    if trembling:
        scans[:, 2:5, 3:6] += 5 * np.sin(np.arange(len(scans)) / 20)[:, None, None]
    return scans


def pat(seconds: float, counts: float = 40.0) -> Scans:
    """Taps at 3.5 Hz, on the pad a third of the time."""
    down = (np.arange(round(seconds * 54)) * 3.5 / 54) % 1 < 1 / 3
    scans: Scans = palm(seconds, counts, trembling=False) * down[:, None, None]
    return scans
