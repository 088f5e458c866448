"""The Grenoble challenge system: a random forest and a support vector machine on 273 features.

V.-C. Ta, W. Johal, M. Portaz, E. Castelli, D. Vaufreydaz, "The Grenoble System for the Social Touch Challenge
at ICMI 2015", doi 10.1145/2818346.2830598. From the paper: one classifier of each kind, designed on CoST and
applied unchanged to HAART. The number of features is also in Albawi et al. 2018 (doi 10.1155/2018/6973103),
table 4.

Written without the section on features; the 273 are our choice: three numbers a taxel (192), 40 of the whole
window, after Jung et al. 2014 (doi 10.1145/2663204.2663242), and 41 of the mean pressure over time. Kernel
and settings are our choice too, made on training participants.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import MAX_COUNT
from touchd.model.studies.challenge import features as shared
from touchd.model.training.metrics import Floats

BAND_EDGES_HZ = np.linspace(0.0, 13.5, 21)
COUNT_EDGES = (0, 2, 4, 8, 16, 64, 256, 512, MAX_COUNT + 1)
REPEAT_FRAMES = 36
"""The longest lag of the autocorrelation: a repetition of 1.5 Hz."""
QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)
FORESTS = ({"max_features": "sqrt"}, {"max_features": 0.2})
MACHINES = tuple({"C": C, "gamma": gamma} for C in (10.0, 100.0, 1000.0) for gamma in (0.0001, 0.0003, 0.001))


def features(counts: NDArray[np.uint16]) -> Floats:
    """Return the 273 features (N, 273) of windows of counts (N, L, 8, 8)."""
    return np.hstack([taxel_features(counts), global_features(counts), sequence_features(counts)])


def taxel_features(counts: NDArray[np.uint16]) -> Floats:
    """Return mean, greatest and standard deviation of each taxel over time (N, 192)."""
    over_time = counts.mean(axis=1), counts.max(axis=1), counts.std(axis=1)
    return np.hstack([each.reshape(len(counts), -1).astype(np.float64) for each in over_time])


def global_features(counts: NDArray[np.uint16]) -> Floats:
    """Return features of the whole window (N, 40): pressure, its place, its area, its path."""
    values = counts.astype(np.float64)
    pressure, area, path = shared.mean_pressure(values), shared.contact_area(values), shared.centroid(values)
    moved = shared.steps(path)
    hardest = pressure.argmax(axis=1)
    flat = values.reshape(len(values), -1)
    shares = [((flat >= low) & (flat < high)).mean(axis=1) for low, high in pairwise(COUNT_EDGES)]
    return np.column_stack(
        [
            flat.mean(axis=1),
            flat.max(axis=1),
            pressure.std(axis=1),
            np.abs(np.diff(values, axis=1)).mean(axis=(1, 2, 3)),
            values.mean(axis=(1, 3)),
            values.mean(axis=(1, 2)),
            area.mean(axis=1),
            area[np.arange(len(area)), hardest],
            shared.crossings(pressure),
            shared.crossings(values.max(axis=(2, 3))),
            moved.mean(axis=1),
            moved.std(axis=1),
            path.mean(axis=1),
            path.std(axis=1),
            np.linalg.norm(path[:, -1] - path[:, 0], axis=1),
            *shares,
            (pressure > pressure.max(axis=1, keepdims=True) / 2).mean(axis=1),
        ]
    )


def sequence_features(counts: NDArray[np.uint16]) -> Floats:
    """Return features of the mean pressure over time (N, 41): bands, rhythm, quantiles, changes, repeats."""
    pressure = shared.mean_pressure(counts)
    change = np.diff(pressure, axis=1)
    return np.hstack(
        [
            np.log1p(shared.bands(pressure, BAND_EDGES_HZ)),
            shared.rhythm(pressure),
            np.quantile(pressure, QUANTILES, axis=1).T,
            np.column_stack([np.abs(change).mean(axis=1), change.std(axis=1), change.max(axis=1)]),
            shared.describe(pressure)[:, -2:],
            shared.autocorrelations(pressure, REPEAT_FRAMES)[:, REPEAT_FRAMES // 9 - 1 :: 4][:, :8],
        ]
    )


def machine(settings: dict[str, Any], seed: int) -> Any:
    """Return an untrained support vector machine on standardised features; `seed` has no effect."""
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler
    from sklearn.svm import SVC

    return make_pipeline(StandardScaler(), SVC(**settings))
