"""Gaus and others' challenge systems: a random forest and boosting on five sets of features.

Y. F. A. Gaus, T. Olugbade, A. Jan, R. Qin, J. Liu, F. Zhang, H. Meng, N. Bianchi-Berthouze, "Social Touch
Gesture Recognition using Random Forest and Boosting on Distinct Feature Sets", ICMI 2015, doi
10.1145/2818346.2830599. From its abstract: five distinct feature sets of touch on a grid of sensors, combined
for a random forest and for boosting; the boosting is AdaBoost.MH over weak learners, from the MultiBoost
library (Benbouzid et al. 2012).

Written without the paper's full text. We take the five sets to be: statistics of pressure, of binary motion
and of motion, a motion history histogram at several scales (Meng et al. 2009) and local binary patterns on
three orthogonal planes (Zhao and Pietikainen 2007). Their statistics, thresholds, scales and lengths are our
choice. scikit-learn has no AdaBoost.MH; the nearest is SAMME (Zhu et al. 2009) over small trees, which weighs
windows where AdaBoost.MH weighs windows and classes.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, ROWS
from touchd.model.studies.challenge import features as shared
from touchd.model.training.metrics import Floats

MOTION_COUNTS = 4
"""A taxel moves if it changes by more than this in a frame, as fewer than 1 in 1000 do on untouched pads."""
LONGEST_RUN = 5
SCALES = (1, 2, 4)
NEIGHBOURS = ((-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1))
FORESTS = ({"max_features": "sqrt"}, {"max_features": 0.1})
BOOSTS = tuple({"depth": depth, "rounds": 100} for depth in (1, 2, 4, 6, 8))


def features(counts: NDArray[np.uint16]) -> Floats:
    """Return all five sets of features side by side (N, 724) of windows of counts (N, L, 8, 8)."""
    values = counts.astype(np.int32)
    change = np.abs(np.diff(values, axis=1))
    moving = change > MOTION_COUNTS
    pressed_and_moved = distribution(values), distribution(change)
    return np.hstack(
        [*pressed_and_moved, binary_motion(moving), motion_history(moving), binary_patterns(values)]
    )


def distribution(values: NDArray[np.int32]) -> Floats:
    """Return statistics over time of the frames' mean, spread, maximum and median (N, 28)."""
    space = (2, 3)
    over_frame = values.mean(space), values.std(space), values.max(space), np.median(values, space)
    return np.hstack([shared.describe(each.astype(np.float64)) for each in over_frame])


def binary_motion(moving: NDArray[np.bool_]) -> Floats:
    """Return statistics of how many taxels move at once (N, 7), and each taxel's share of time (N, 64)."""
    at_once = moving.mean(axis=(2, 3))
    return np.hstack([shared.describe(at_once), moving.mean(axis=1).reshape(len(moving), -1)])


def motion_history(moving: NDArray[np.bool_]) -> Floats:
    """Return how often each block of taxels moves for exactly 1, 2, ... 5 frames (N, 84 * 5).

    A block of 1, 2 x 2 or 4 x 4 taxels moves if one of its taxels does. Counts are shares of the frames.
    """
    histograms = []
    for scale in SCALES:
        parts = moving.reshape(*moving.shape[:2], ROWS // scale, scale, COLUMNS // scale, scale)
        blocks = parts.any(axis=(3, 5))
        runs = run_lengths(blocks.reshape(*blocks.shape[:2], -1))
        histograms.append((runs / moving.shape[1]).reshape(len(moving), -1))
    return np.hstack(histograms)


def run_lengths(moving: NDArray[np.bool_], longest: int = LONGEST_RUN) -> NDArray[np.int64]:
    """Return the number of runs of exactly 1 to `longest` frames (N, longest, K) in K signals (N, T, K)."""
    padded = np.pad(moving, ((0, 0), (1, longest + 1), (0, 0)))
    frames = moving.shape[1]
    # going[t]: moving from t to t + length - 1, and not before; a run of that length also ends there.
    begins = ~padded[:, :frames] & padded[:, 1 : frames + 1]
    counts = []
    going = begins
    for length in range(1, longest + 1):
        after = padded[:, length + 1 : length + 1 + frames]
        counts.append((going & ~after).sum(axis=1))
        going = going & after
    return np.stack(counts, axis=1)


def binary_patterns(values: NDArray[np.int32]) -> Floats:
    """Return histograms of local binary patterns on the planes of rows, columns and time (N, 3 * 59)."""
    return np.hstack([histograms(values, 2, 3), histograms(values, 1, 2), histograms(values, 1, 3)])


def histograms(values: NDArray[np.int32], one: int, other: int) -> Floats:
    """Return the histogram (N, 59) of the 8 neighbours' patterns on the plane of two axes of (N, T, 8, 8)."""
    inner = [slice(None)] * values.ndim
    inner[one] = inner[other] = slice(1, -1)
    centre = values[tuple(inner)]
    patterns = np.zeros(centre.shape, dtype=np.uint8)
    for bit, (first, second) in enumerate(NEIGHBOURS):
        beside = list(inner)
        beside[one] = slice(1 + first, values.shape[one] - 1 + first)
        beside[other] = slice(1 + second, values.shape[other] - 1 + second)
        patterns |= (values[tuple(beside)] >= centre).astype(np.uint8) << np.uint8(bit)
    bins = uniform_bins()[patterns].reshape(len(values), -1)
    offset = np.arange(len(values))[:, np.newaxis] * 59
    counted = np.bincount((bins + offset).ravel(), minlength=len(values) * 59)
    return np.asarray(counted.reshape(len(values), 59) / bins.shape[1])


def uniform_bins() -> NDArray[np.int64]:
    """Return the bin of each of 256 patterns: its own for the 58 with at most two changes, else 58."""
    bits = (np.arange(256)[:, np.newaxis] >> np.arange(8)) & 1
    uniform = (bits != np.roll(bits, 1, axis=1)).sum(axis=1) <= 2
    return np.where(uniform, uniform.cumsum() - 1, 58)


def boosting(settings: dict[str, Any], seed: int) -> Any:
    """Return untrained boosted trees; each split considers a random tenth of the features, to save time."""
    from sklearn.ensemble import AdaBoostClassifier
    from sklearn.tree import DecisionTreeClassifier

    weak = DecisionTreeClassifier(max_depth=settings["depth"], max_features=0.1)
    return AdaBoostClassifier(weak, n_estimators=settings["rounds"], random_state=seed)
