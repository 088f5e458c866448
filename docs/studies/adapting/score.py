"""How a head does on HAART windows that it never learnt from, and which recordings those are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from torch import nn

from docs.studies.adapting.cells import KS, Score
from drivers.recording import Recording
from model.adapt.adapt import logits
from model.adapt.backbone import Windows
from model.settings import LENGTHS
from model.training import haart, metrics


def draw(recordings: Sequence[Recording], name: str, number: int) -> tuple[list[list[int]], list[int]]:
    """Return, of a random order of each gesture of a participant, the first four recordings, and the rest."""
    rng = np.random.default_rng([number, *name.encode()])
    first, rest = [], []
    for gesture in haart.GESTURES:
        own = [i for i, each in enumerate(recordings) if (each.participant, each.gesture) == (name, gesture)]
        order = rng.permutation(own).tolist()
        first.append(order[: KS[-1]])
        rest += order[KS[-1] :]
    return first, rest


def score(
    head: nn.Sequential,
    temperatures: Mapping[int, float],
    recordings: Sequence[Recording],
    cut: Mapping[int, Windows],
    asked: NDArray[np.int64],
) -> Score:
    """Return how well a head answers for the windows of the recordings that are asked about."""
    accuracy, error = {}, 0.0
    for length in LENGTHS:
        chosen = np.isin(cut[length].recordings, asked)
        truth = truth_of(recordings, cut[length], chosen)
        answers = logits(head, cut[length], chosen) / temperatures[length]
        predicted = answers.argmax(axis=1).astype(np.int64)
        accuracy[str(length)] = round(metrics.macro_accuracy(predicted, truth, len(haart.GESTURES)), 5)
        odds = np.exp(answers - answers.max(axis=1, keepdims=True))
        error = metrics.expected_calibration_error(odds / odds.sum(axis=1, keepdims=True), truth)
    return Score(accuracy=accuracy, calibration_error=round(error, 5))


def truth_of(recordings: Sequence[Recording], cut: Windows, chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the classes (W,) of chosen windows."""
    return np.array([haart.label(recordings[i]) for i in cut.recordings[chosen]], dtype=np.int64)


def per_gesture(answers: NDArray[np.float64], truth: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return each gesture's share of right answers (7,) from logits (W, 7)."""
    predicted = answers.argmax(axis=1).astype(np.int64)
    return metrics.class_accuracies(predicted, truth, len(haart.GESTURES))
