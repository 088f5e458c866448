"""Building blocks of the hand-crafted features: series over time, and numbers that describe a series.

Windows are counts (N, L, 8, 8), series over their frames (N, L). All results are float64 and finite, also for
an untouched pad.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS
from touchd.model.training.metrics import Floats

Values = NDArray[np.uint16] | NDArray[np.int32] | Floats

CONTACT_COUNTS = 20
"""A taxel counts as touched above this; fewer than 1 in 1000 counts of untouched training pads are higher."""
TINY = 1e-9
TREES = 300


def mean_pressure(counts: Values) -> Floats:
    """Return the mean count of each frame (N, L)."""
    return np.asarray(counts.mean(axis=(2, 3), dtype=np.float64))


def contact_area(counts: Values) -> Floats:
    """Return the share of touched taxels in each frame (N, L), 0 to 1."""
    return np.asarray((counts > CONTACT_COUNTS).mean(axis=(2, 3)))


def centroid(counts: Values) -> Floats:
    """Return each frame's centre of pressure (N, L, 2): row and column in taxels, 3.5 where all are zero."""
    total = counts.sum(axis=(2, 3), dtype=np.float64)
    rows = counts.sum(axis=3, dtype=np.float64) @ np.arange(ROWS)
    columns = counts.sum(axis=2, dtype=np.float64) @ np.arange(COLUMNS)
    places = [
        np.where(total > 0.0, moment / np.maximum(total, TINY), (side - 1) / 2)
        for moment, side in ((rows, ROWS), (columns, COLUMNS))
    ]
    return np.stack(places, axis=-1)


def steps(path: Floats) -> Floats:
    """Return the distance between successive points (N, L - 1) of a path (N, L, 2)."""
    return np.asarray(np.linalg.norm(np.diff(path, axis=1), axis=2))


def describe(series: Floats) -> Floats:
    """Return mean, standard deviation, least, greatest, median, skewness and kurtosis (N, 7) of series."""
    spread = series.std(axis=1)
    mean = series.mean(axis=1)
    moves = spread > TINY
    standard = (series - mean[:, np.newaxis]) / np.maximum(spread, TINY)[:, np.newaxis]
    # The moments of a constant series are 0 / 0; they are set to a normal distribution's.
    skewness = np.where(moves, (standard**3).mean(axis=1), 0.0)
    kurtosis = np.where(moves, (standard**4).mean(axis=1) - 3.0, 0.0)
    least, greatest, median = series.min(axis=1), series.max(axis=1), np.median(series, axis=1)
    return np.column_stack([mean, spread, least, greatest, median, skewness, kurtosis])


def crossings(series: Floats) -> Floats:
    """Return how many times a second each series rises above its mean (N,): peaks in Jung et al. 2014."""
    above = series > series.mean(axis=1, keepdims=True) + TINY
    rises = (~above[:, :-1] & above[:, 1:]).sum(axis=1)
    return np.asarray(rises * FRAME_RATE_HZ / series.shape[1])


def amplitudes(series: Floats) -> tuple[Floats, Floats]:
    """Return frequencies (F,) in Hz and amplitudes (N, F) of series minus their mean, without 0 Hz."""
    still = series - series.mean(axis=1, keepdims=True)
    spectrum = np.abs(np.fft.rfft(still, axis=1))[:, 1:] * (2.0 / series.shape[1])
    frequencies = np.fft.rfftfreq(series.shape[1], 1.0 / FRAME_RATE_HZ)[1:]
    return np.asarray(frequencies, dtype=np.float64), spectrum


def bands(series: Floats, edges_hz: Floats) -> Floats:
    """Return the power of series in each band between neighbouring edges (N, len(edges) - 1)."""
    frequencies, spectrum = amplitudes(series)
    band = np.digitize(frequencies, edges_hz) - 1
    power = np.zeros((len(series), len(edges_hz) - 1))
    for index in range(power.shape[1]):
        power[:, index] = np.square(spectrum[:, band == index]).sum(axis=1)
    return power


def rhythm(series: Floats) -> Floats:
    """Return the strongest frequency in Hz, the spectrum's mean in Hz and its entropy in nats (N, 3)."""
    frequencies, spectrum = amplitudes(series)
    power = np.square(spectrum)
    moves = power.max(axis=1) > TINY
    shares = power / np.maximum(power.sum(axis=1, keepdims=True), TINY)
    strongest = np.where(moves, frequencies[power.argmax(axis=1)], 0.0)
    entropy = -(shares * np.log(np.maximum(shares, TINY))).sum(axis=1)
    return np.column_stack([strongest, shares @ frequencies, entropy])


def autocorrelations(series: Floats, lag_frames: int) -> Floats:
    """Return the autocorrelation at lags 1 to `lag_frames` (N, lag_frames); 0 for a constant series."""
    still = series - series.mean(axis=1, keepdims=True)
    power = np.square(still).sum(axis=1)
    moves = power > TINY
    products = [(still[:, lag:] * still[:, :-lag]).sum(axis=1) for lag in range(1, lag_frames + 1)]
    return np.stack([np.where(moves, each / np.maximum(power, TINY), 0.0) for each in products], axis=1)


def forest(settings: dict[str, Any], seed: int) -> Any:
    """Return an untrained random forest."""
    # Importing scikit-learn takes longer than reading stored figures, which is all that most commands do.
    from sklearn.ensemble import RandomForestClassifier

    return RandomForestClassifier(TREES, **settings, random_state=seed)
