"""Balli Altuglu and Altun's challenge system: a random forest on a few features, selected one by one.

T. Balli Altuglu, K. Altun, "Recognizing Touch Gestures for Social Human-Robot Interaction", ICMI 2015, doi
10.1145/2818346.2830600. From its abstract: pressure data, image features, Hurst exponent, Hjorth parameters
and coefficients of an autoregressive model; selection by sequential forward floating search; random forest.

Written without the paper's full text. Our choices: the series that the last three describe, the model's
order, the image's moments, and the extent of the search, which scores small forests on people held out.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, ROWS
from touchd.model.studies.challenge import features as shared
from touchd.model.studies.challenge.features import TINY
from touchd.model.training.metrics import Floats

ORDER = 4
SHORTEST_HURST_FRAMES = 8
SEARCH_TREES = 20
SERIES = ("mean pressure", "greatest count", "row", "column", "touched area")
OF_IMAGE = ("row", "column", "long axis", "short axis", "eccentricity", "hardest share")
OF_SERIES = (
    "mean",
    "deviation",
    "least",
    "greatest",
    "median",
    "skewness",
    "kurtosis",
    "Hurst exponent",
    "activity",
    "mobility",
    "complexity",
    *(f"autoregression {lag}" for lag in range(1, ORDER + 1)),
)
NAMES = (
    *(f"image's {name}" for name in OF_IMAGE),
    *(f"{name} of {series}" for series in SERIES for name in OF_SERIES),
)
"""Names of the candidate features, in order."""


def features(counts: NDArray[np.uint16]) -> Floats:
    """Return the candidate features (N, 81) of windows of counts (N, L, 8, 8)."""
    path = shared.centroid(counts)
    greatest = counts.max(axis=(2, 3)).astype(np.float64)
    series = (shared.mean_pressure(counts), greatest, *np.moveaxis(path, -1, 0), shared.contact_area(counts))
    columns = [image_features(counts.mean(axis=1, dtype=np.float64))]
    for each in series:
        columns += [shared.describe(each), hurst(each)[:, np.newaxis], hjorth(each), autoregressive(each)]
    return np.hstack(columns)


def image_features(image: Floats) -> Floats:
    """Return features of the mean frame (N, 8, 8) as an image, (N, 6).

    Centre (row, column), the longer and shorter axis of its ellipse of inertia in taxels, its eccentricity
    (0 to 1), and the share of the pressure on the hardest taxel.
    """
    total = np.maximum(image.sum(axis=(1, 2)), TINY)
    shares = image / total[:, np.newaxis, np.newaxis]
    centre = shared.centroid(image[:, np.newaxis])[:, 0]
    down = np.arange(ROWS) - centre[:, :1]
    across = np.arange(COLUMNS) - centre[:, 1:]
    second = np.empty((len(image), 2, 2))
    second[:, 0, 0] = (shares.sum(axis=2) * down**2).sum(axis=1)
    second[:, 1, 1] = (shares.sum(axis=1) * across**2).sum(axis=1)
    second[:, 0, 1] = second[:, 1, 0] = np.einsum("nrc,nr,nc->n", shares, down, across)
    short, long = np.sqrt(np.maximum(np.linalg.eigvalsh(second), 0.0)).T
    eccentricity = np.sqrt(np.maximum(1.0 - (short / np.maximum(long, TINY)) ** 2, 0.0))
    return np.column_stack([centre, long, short, eccentricity, shares.max(axis=(1, 2))])


def hurst(series: Floats) -> Floats:
    """Return the Hurst exponent (N,) by rescaled range (Hurst 1951); 0.5 for a constant series.

    It is the slope of log(R / S) over log(n) for n of 8, 16, ... frames.
    """
    sizes, scaled = [], []
    size = SHORTEST_HURST_FRAMES
    while size <= series.shape[1]:
        pieces = series[:, : series.shape[1] // size * size].reshape(len(series), -1, size)
        sums = (pieces - pieces.mean(axis=2, keepdims=True)).cumsum(axis=2)
        spread = pieces.std(axis=2)
        moves = spread > TINY
        ratio = np.where(moves, np.ptp(sums, axis=2) / np.maximum(spread, TINY), 0.0).sum(axis=1)
        sizes.append(size)
        scaled.append(ratio / np.maximum(moves.sum(axis=1), 1))
        size *= 2
    logs = np.log(np.maximum(np.stack(scaled, axis=1), TINY))
    places = np.log(sizes) - np.log(sizes).mean()
    slopes = logs @ places / (places @ places)
    # A constant piece among others would measure TINY, not the series.
    whole = (np.stack(scaled, axis=1) > 0.0).all(axis=1)
    return np.where(whole, slopes, 0.5)


def hjorth(series: Floats) -> Floats:
    """Return Hjorth's activity, mobility and complexity (N, 3), with frames as time unit (Hjorth 1970)."""
    first = np.diff(series, axis=1)
    second = np.diff(first, axis=1)
    activity, slope, bend = series.var(axis=1), first.var(axis=1), second.var(axis=1)
    mobility = np.sqrt(slope / np.maximum(activity, TINY))
    complexity = np.sqrt(bend / np.maximum(slope, TINY)) / np.maximum(mobility, TINY)
    return np.column_stack([activity, mobility, np.where(slope > TINY, complexity, 0.0)])


def autoregressive(series: Floats, order: int = ORDER) -> Floats:
    """Return the coefficients (N, order) of an autoregressive model by the Yule-Walker equations."""
    correlation = np.hstack([np.ones((len(series), 1)), shared.autocorrelations(series, order)])
    lags = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
    # A constant series has no unique solution; the smallest ridge picks one.
    matrix = correlation[:, lags] + 1e-6 * np.eye(order)
    return np.asarray(np.linalg.solve(matrix, correlation[:, 1:, np.newaxis])[..., 0])


def forest(settings: dict[str, Any], seed: int) -> Any:
    """Return an untrained forest on the columns `settings["features"]`, with the other settings."""
    from sklearn.compose import make_column_transformer
    from sklearn.pipeline import make_pipeline

    others = {name: value for name, value in settings.items() if name != "features"}
    chosen = make_column_transformer(("passthrough", settings["features"]))
    return make_pipeline(chosen, shared.forest(others, seed))
