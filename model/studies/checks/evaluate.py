"""Scores of a classifier on windows: by length, gesture, person, condition and disturbance.

As in the paper: 432 // L non-overlapping windows per recording, and accuracy averaged over the gestures.
"""

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import OTHER
from touchd.drivers.recording import Recording
from touchd.model.classifier import Classifier
from touchd.model.settings import LENGTHS
from touchd.model.studies.checks.disturb import DISTURBANCES, Disturb
from touchd.model.training import haart, metrics

REPORTED_LENGTHS = (9, 27, 54, 72, 81, 108, 144, 216)
SCENE = ("constant", "pat", "stroke")
BATCH = 16


class Score(msgspec.Struct, frozen=True, kw_only=True):
    """Scores over the windows of one length. Accuracies are averaged over gestures, from 0 to 1."""

    frames: int
    windows: int
    accuracy: float
    right: float
    """Share of all windows, not averaged over gestures."""
    interval: tuple[float, float]
    """95 % bootstrap interval of the mean over participants."""
    per_class: dict[str, float]
    per_participant: dict[str, float]
    per_condition: dict[str, float]
    negative_log_likelihood: float
    calibration_error: float
    confusion: list[list[int]]
    """Row: true gesture; column: answer; both in the order of the labels."""
    scene_accuracy: float
    """Accuracy on windows of SCENE's gestures alone, answered with the likeliest of these and of `other`."""
    scene_unrestricted_accuracy: float
    """The same windows, answered with the likeliest of all gestures."""


class Evaluation(msgspec.Struct, frozen=True, kw_only=True):
    """All scores of one set of participants."""

    realigned: list[Score]
    published: list[Score]
    """In HAART's own framing; empty for recordings that hold whole scans."""
    disturbed: dict[str, float]
    """Accuracy at the longest answer, realigned, under each disturbance; "none" is undisturbed."""


Split = Sequence[tuple[Classifier, Sequence[Recording]]]
"""Classifiers, each with the recordings that it classifies."""


def evaluate(split: Split, missing: Sequence[str] = ()) -> Evaluation:
    """Score every length in both framings, and the longest answer under every disturbance.

    missing: gestures that the recordings do not contain and that are not allowed as answers.
    """
    live = [(classifier, haart.realigned(recordings)) for classifier, recordings in split]
    published = any(recording.framing == "published" for _, recordings in split for recording in recordings)
    return Evaluation(
        realigned=[score(live, length, missing=missing) for length in REPORTED_LENGTHS],
        published=[score(split, length, missing=missing) for length in REPORTED_LENGTHS] if published else [],
        disturbed={
            name: score(live, LENGTHS[-1], disturb, missing).accuracy
            for name, disturb in DISTURBANCES.items()
        },
    )


def score(split: Split, length: int, disturb: Disturb | None = None, missing: Sequence[str] = ()) -> Score:
    """Score all windows of one length; `missing` as in `evaluate`."""
    labels, classes = split[0][0].labels, len(split[0][0].labels)
    windows = [haart.cut(recordings, length) for _, recordings in split]
    probabilities = np.concatenate(
        [answer(classifier, w.counts, disturb) for (classifier, _), w in zip(split, windows, strict=True)]
    )
    if missing:
        probabilities[:, [labels.index(gesture) for gesture in missing]] = 0.0
        probabilities /= probabilities.sum(axis=1, keepdims=True)
    truth = np.concatenate([w.labels for w in windows])
    participants = np.concatenate([w.participants for w in windows])
    conditions = np.concatenate([w.conditions for w in windows])
    predicted = probabilities.argmax(axis=1).astype(np.int64)

    def accuracy(chosen: NDArray[np.bool_]) -> float:
        return metrics.macro_accuracy(predicted[chosen], truth[chosen], classes)

    kept = np.array([labels.index(gesture) for gesture in SCENE])
    scene = np.isin(truth, kept)
    # A touch that is none of the gestures can occur in every scene.
    answers = np.array([*kept, *(place for place, label in enumerate(labels) if label == OTHER)])
    in_scene = answers[probabilities[:, answers].argmax(axis=1)]
    per_class = zip(labels, metrics.class_accuracies(predicted, truth, classes).tolist(), strict=True)
    return Score(
        frames=length,
        windows=len(truth),
        accuracy=metrics.macro_accuracy(predicted, truth, classes),
        right=float((predicted == truth).mean()),
        interval=metrics.participant_interval(accuracy, participants),
        per_class={gesture: share for gesture, share in per_class if gesture not in (*missing, OTHER)},
        per_participant={str(name): accuracy(participants == name) for name in np.unique(participants)},
        per_condition={str(name): accuracy(conditions == name) for name in np.unique(conditions)},
        negative_log_likelihood=metrics.negative_log_likelihood(probabilities, truth),
        calibration_error=metrics.expected_calibration_error(probabilities, truth),
        confusion=metrics.confusion(predicted, truth, classes).tolist(),
        scene_accuracy=metrics.macro_accuracy(in_scene[scene], truth[scene], classes),
        scene_unrestricted_accuracy=accuracy(scene),
    )


def answer(
    classifier: Classifier, counts: NDArray[np.uint16] | NDArray[np.float32], disturb: Disturb | None = None
) -> NDArray[np.float64]:
    """Return probabilities (N, labels) for windows (N, L, 8, 8), after `disturb` if there is one."""
    batches = []
    for start in range(0, len(counts), BATCH):
        batch = counts[start : start + BATCH].astype(np.float32)
        batches.append(classifier.batch_probabilities(disturb(batch) if disturb else batch))
    return np.concatenate(batches)
