"""Calibrates confidences: of answers with 0.8, 8 in 10 are right for people whom the network never saw.

Temperature scaling (Guo et al. 2017), one temperature per length, fitted on held-out participants: each
training recording is answered by the network that was trained without its participant.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import log_softmax

from touchd.drivers.frame import NO_TOUCH, OTHER
from touchd.drivers.recording import Recording
from touchd.model.settings import LENGTHS
from touchd.model.tgc import TGC
from touchd.model.training import haart, metrics
from touchd.model.training.checkpoint import Checkpoint
from touchd.model.training.metrics import Floats, Labels
from touchd.model.training.studies import MISSING, study_of

BATCH = 64
IMPOSSIBLE = -1e4
TEMPERATURES = np.geomspace(0.3, 5.0, 200)


Answers = Mapping[int, tuple[Floats, Labels]]
"""A network's answers about held-out people: logits (N, classes) and labels (N,) by length."""


def ask_left_out(saved: Checkpoint, recordings: Sequence[Recording]) -> Answers:
    """Return a network's answers about the people of a study that its training held out; see `ask`."""
    return ask(saved, haart.only(recordings, saved.settings.left_out))


def ask(saved: Checkpoint, recordings: Sequence[Recording]) -> Answers:
    """Return a network's answers about one study's recordings, as they are scored, at every answered length.

    An answer that the study cannot contain gets the logit IMPOSSIBLE.
    """
    network = saved.build()
    missing = [
        saved.labels.index(gesture) for gesture in MISSING.get(study_of(recordings[0].participant), ())
    ]
    answers = {}
    for length in LENGTHS:
        windows = haart.cut(recordings, length)
        logits = _logits(network, windows.counts)
        logits[:, missing] = IMPOSSIBLE
        answers[length] = logits, windows.labels
    return answers


def fit_shift(studies: Sequence[Sequence[Answers]], labels: Sequence[str], most: Sequence[float]) -> float:
    """Return what to add to the logit of `other`, so that few touches of held-out people become `other`.

    studies: the answers about each study's people. most: the largest share of such touches for each study.
    """
    other, rest = labels.index(OTHER), labels.index(NO_TOUCH)
    shifts = []
    for answers, share in zip(studies, most, strict=True):
        margins = []
        for length in LENGTHS:
            logits, truth = _together(answers, length)
            touched = logits[truth != rest]
            margins.append(touched[:, other] - np.delete(touched, other, axis=1).max(axis=1))
        shifts.append(-float(np.quantile(np.concatenate(margins), 1.0 - share)))
    return min(shifts)


def shifted(answers: Answers, labels: Sequence[str], shift: float) -> Answers:
    """Return answers with the shift added to the logit of `other`."""
    added = np.array([shift if label == OTHER else 0.0 for label in labels])
    return {length: (logits + added, truth) for length, (logits, truth) in answers.items()}


def fit_temperatures(answers: Sequence[Answers]) -> dict[int, float]:
    """Return the temperature with the largest likelihood of the held-out labels, for each length."""
    return {length: fit_temperature(*_together(answers, length)) for length in LENGTHS}


def _together(answers: Sequence[Answers], length: int) -> tuple[Floats, Labels]:
    logits, labels = zip(*(answer[length] for answer in answers), strict=True)
    return np.concatenate(logits), np.concatenate(labels)


def highest(studies: Iterable[Mapping[int, float]]) -> dict[int, float]:
    """Return the highest temperature of any study at each length, which claims the least confidence."""
    fitted = list(studies)
    return {length: max(temperatures[length] for temperatures in fitted) for length in LENGTHS}


def accuracies(answers: Sequence[Answers]) -> dict[str, float]:
    """Return the macro accuracy over held-out participants at each length."""
    scores = {}
    for length in LENGTHS:
        logits, labels = _together(answers, length)
        predicted = logits.argmax(axis=1).astype(np.int64)
        scores[str(length)] = round(metrics.macro_accuracy(predicted, labels, logits.shape[1]), 4)
    return scores


def fit_temperature(logits: Floats, labels: Labels) -> float:
    """Return the temperature from TEMPERATURES with the smallest negative log likelihood."""

    def cross_entropy(temperature: float) -> float:
        likelihoods = log_softmax(logits / temperature, axis=1)[np.arange(len(labels)), labels]
        return -float(likelihoods.mean())

    return float(min(TEMPERATURES, key=cross_entropy))


def _logits(network: TGC, counts: NDArray[np.uint16] | NDArray[np.float32]) -> Floats:
    with torch.no_grad():
        batches = [
            network(torch.from_numpy(counts[start : start + BATCH].astype(np.float32)))
            for start in range(0, len(counts), BATCH)
        ]
    return torch.cat(batches).numpy().astype(np.float64)
