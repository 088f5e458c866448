"""Metrics of answers: accuracy by class and participant, calibration, and confidence intervals."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Labels = NDArray[np.int64]

CALIBRATION_BINS = 10
BOOTSTRAP_DRAWS = 10_000


def confusion(predicted: Labels, labels: Labels, classes: int) -> NDArray[np.int64]:
    """Return counts (classes, classes): row is the true class, column the predicted one."""
    counts = np.zeros((classes, classes), dtype=np.int64)
    np.add.at(counts, (labels, predicted), 1)
    return counts


def class_accuracies(predicted: Labels, labels: Labels, classes: int) -> Floats:
    """Return each class's share of right answers (classes,); nan where a class does not occur."""
    counts = confusion(predicted, labels, classes)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.diag(counts) / counts.sum(axis=1))


def macro_accuracy(predicted: Labels, labels: Labels, classes: int) -> float:
    """Return the accuracy averaged over the classes that occur, as the paper scores."""
    return float(np.nanmean(class_accuracies(predicted, labels, classes)))


def negative_log_likelihood(probabilities: Floats, labels: Labels) -> float:
    """Return the mean of -log of the probability (N, classes) given to the true label (N,)."""
    given = probabilities[np.arange(len(labels)), labels]
    return float(-np.log(np.maximum(given, 1e-12)).mean())


def expected_calibration_error(probabilities: Floats, labels: Labels) -> float:
    """Return the mean gap between confidence and accuracy over ten equal bins (Naeini et al. 2015)."""
    confidence = probabilities.max(axis=1)
    right = probabilities.argmax(axis=1) == labels
    bins = np.minimum((confidence * CALIBRATION_BINS).astype(int), CALIBRATION_BINS - 1)
    gaps = (
        abs(confidence[bins == b].mean() - right[bins == b].mean()) * (bins == b).mean()
        for b in np.unique(bins)
    )
    return float(sum(gaps))


def participant_interval(
    score: Callable[[NDArray[np.bool_]], float], participants: NDArray[np.str_], seed: int = 0
) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the mean score over participants, drawn with replacement.

    score: maps a mask over windows (N,) to one participant's score.
    """
    each = np.array([score(participants == name) for name in np.unique(participants)])
    rng = np.random.default_rng(seed)
    draws = rng.integers(len(each), size=(BOOTSTRAP_DRAWS, len(each)))
    low, high = np.percentile(each[draws].mean(axis=1), [2.5, 97.5])
    return float(low), float(high)
