"""The classifier's scores on windows: by length, class, participant, condition, framing and disturbance.

Windows are the paper's: 432 // L non-overlapping windows a recording, accuracy averaged over classes. "Test"
is the challenge's test participants; nothing was chosen on them. "Left out" is HAART's training participants,
each answered by a network of the same recipe that never saw them; "second study" is that study's people, in
the same way.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.drivers.recording import Recording
from touchd.model.classifier import Classifier
from touchd.model.settings import LENGTHS
from touchd.model.studies.checks.disturb import DISTURBANCES, Disturb
from touchd.model.training import haart, metrics

REPORTED_LENGTHS = (9, 27, 54, 72, 81, 108, 144, 216)
SCENE = ("constant", "pat", "stroke")
BATCH = 64


class Score(msgspec.Struct, frozen=True, kw_only=True):
    """Scores over the windows of one length. Accuracies are macro averages, shares from 0 to 1."""

    frames: int
    windows: int
    accuracy: float
    right: float
    """Share of all windows, not averaged over classes."""
    interval: tuple[float, float]
    """95 % bootstrap interval of the mean over participants."""
    per_class: dict[str, float]
    per_participant: dict[str, float]
    per_condition: dict[str, float]
    negative_log_likelihood: float
    calibration_error: float
    confusion: list[list[int]]
    """Row: true class; column: answer; both in the order of the labels."""
    scene_accuracy: float
    """Windows of SCENE's gestures alone, answered with the likeliest of these."""
    scene_unrestricted_accuracy: float
    """The same windows, with all gestures left possible."""


class Evaluation(msgspec.Struct, frozen=True, kw_only=True):
    """Everything scored on one set of participants."""

    realigned: list[Score]
    published: list[Score]
    """In HAART's own framing; empty for recordings that hold whole scans."""
    disturbed: dict[str, float]
    """Accuracy at the longest answer, realigned, after each disturbance; "none" is without."""


class Scores(msgspec.Struct, frozen=True, kw_only=True):
    """The machine-written file of scores that stands beside the shipped model."""

    model: str
    model_sha256: str
    command: str
    machine: str
    labels: tuple[str, ...]
    test: Evaluation
    left_out: Evaluation
    second_study: Evaluation
    cross_study: Evaluation
    """The second study's people, answered by the network that learnt from HAART alone, varied widely."""


Split = Sequence[tuple[Classifier, Sequence[Recording]]]
"""Classifiers, each with the published recordings that it is asked about."""


def evaluate(split: Split) -> Evaluation:
    """Score every length in both framings, and the longest answer under every disturbance."""
    live = [(classifier, haart.realigned(recordings)) for classifier, recordings in split]
    published = any(recording.framing == "published" for _, recordings in split for recording in recordings)
    return Evaluation(
        realigned=[score(live, length) for length in REPORTED_LENGTHS],
        published=[score(split, length) for length in REPORTED_LENGTHS] if published else [],
        disturbed={
            name: score(live, LENGTHS[-1], disturb).accuracy for name, disturb in DISTURBANCES.items()
        },
    )


def score(split: Split, length: int, disturb: Disturb | None = None) -> Score:
    """Score all windows of one length, each by the classifier it is paired with."""
    labels, classes = split[0][0].labels, len(split[0][0].labels)
    windows = [haart.cut(recordings, length) for _, recordings in split]
    probabilities = np.concatenate(
        [answer(classifier, w.counts, disturb) for (classifier, _), w in zip(split, windows, strict=True)]
    )
    truth = np.concatenate([w.labels for w in windows])
    participants = np.concatenate([w.participants for w in windows])
    conditions = np.concatenate([w.conditions for w in windows])
    predicted = probabilities.argmax(axis=1).astype(np.int64)

    def accuracy(chosen: NDArray[np.bool_]) -> float:
        return metrics.macro_accuracy(predicted[chosen], truth[chosen], classes)

    kept = np.array([labels.index(gesture) for gesture in SCENE])
    scene = np.isin(truth, kept)
    in_scene = kept[probabilities[:, kept].argmax(axis=1)]
    per_class = metrics.class_accuracies(predicted, truth, classes)
    return Score(
        frames=length,
        windows=len(truth),
        accuracy=metrics.macro_accuracy(predicted, truth, classes),
        right=float((predicted == truth).mean()),
        interval=metrics.participant_interval(accuracy, participants),
        per_class=dict(zip(labels, per_class.tolist(), strict=True)),
        per_participant={str(name): accuracy(participants == name) for name in np.unique(participants)},
        per_condition={str(name): accuracy(conditions == name) for name in np.unique(conditions)},
        negative_log_likelihood=metrics.negative_log_likelihood(probabilities, truth),
        calibration_error=metrics.expected_calibration_error(probabilities, truth),
        confusion=metrics.confusion(predicted, truth, classes).tolist(),
        scene_accuracy=metrics.macro_accuracy(in_scene[scene], truth[scene], classes),
        scene_unrestricted_accuracy=accuracy(scene),
    )


def answer(
    classifier: Classifier, counts: NDArray[np.uint16], disturb: Disturb | None = None
) -> NDArray[np.float64]:
    """Return probabilities (N, 7) for windows (N, L, 8, 8), disturbed first where asked."""
    batches = []
    for start in range(0, len(counts), BATCH):
        batch = counts[start : start + BATCH].astype(np.float32)
        batches.append(classifier.batch_probabilities(disturb(batch) if disturb else batch))
    return np.concatenate(batches)


def read_scores(path: Path) -> Scores:
    """Read a file of scores."""
    return msgspec.json.decode(path.read_bytes(), type=Scores)


def write_scores(scores: Scores, path: Path) -> None:
    """Write a file of scores, one figure a line, rounded to five digits."""
    rounded = json.loads(msgspec.json.encode(scores), parse_float=lambda figure: round(float(figure), 5))
    path.write_bytes(msgspec.json.format(msgspec.json.encode(rounded), indent=1) + b"\n")
