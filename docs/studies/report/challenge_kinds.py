"""The kinds of system in table 1: each chooses its settings, is trained, and names the test windows.

Settings that a paper leaves open are chosen on the training recordings, on whole ones of 432 frames, by
leaving participants out; never on the test file.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import GroupKFold, LeaveOneGroupOut, cross_val_score

from docs.studies.report import challenge_networks
from docs.studies.report.challenge_balli import SEARCH_TREES
from docs.studies.report.challenge_selection import floating_search
from docs.studies.report.ours import model_files
from drivers.recording import Recording
from model.classifier import Classifier
from model.training import haart
from model.training.haart import PUBLISHED_FRAMES, Windows
from model.training.metrics import Floats, Labels
from model.training.threads import one_torch_thread

LEFT_OUT_OF_NETWORKS = ("P10", "P3")
SMOOTHED_EPOCHS = 3
SEARCH_FOLDS = 3
ANSWER_BATCH = 64

Settings = dict[str, Any]
Features = Callable[[NDArray[np.uint16]], Floats]
Build = Callable[[Settings, int], Any]
"""Settings and seed to an untrained classifier of scikit-learn."""


class Data:
    """The recordings as published, each file read when first asked for; features are made once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._made: dict[tuple[Features, int, str], Floats] = {}

    @cached_property
    def training(self) -> list[Recording]:
        """The training participants' recordings."""
        return haart.read_training(self.folder)

    @cached_property
    def test(self) -> list[Recording]:
        """The test participants' recordings."""
        return haart.read_test(self.folder)

    def features(self, make: Features, frames: int, part: Literal["training", "test"]) -> Floats:
        """Return the features of one part's windows."""
        key = (make, frames, part)
        if key not in self._made:
            recordings = self.training if part == "training" else self.test
            self._made[key] = make(haart.cut(recordings, frames).counts)
        return self._made[key]


@dataclass(frozen=True)
class System(ABC):
    """A row of the table. key: its name among the results.

    published: accuracy on test in percent over whole recordings, where there is one. seeds: one training from
    each; a single one where chance has no part.
    """

    key: str
    researchers: str
    algorithm: str
    published: float | None
    seeds: tuple[int, ...] = (0, 1, 2)

    @abstractmethod
    def choose(self, data: Data) -> Settings:
        """Return the settings that the training recordings speak for, and what speaks for them."""

    @abstractmethod
    def answers(
        self, data: Data, chosen: Settings, seed: int, lengths: Sequence[int]
    ) -> Iterator[tuple[int, Labels]]:
        """Train, and yield each length with the class named for each test window (N,)."""

    def in_words(self, settings: Settings) -> str:
        """Return chosen settings as a reader would like them."""
        return ", ".join(f"{name} {value}" for name, value in settings.items())


@dataclass(frozen=True)
class HandMade(System):
    """Features and a classifier of scikit-learn, trained anew a length. options: what is chosen from."""

    features: Features = field(kw_only=True)
    build: Build = field(kw_only=True)
    options: tuple[Settings, ...] = ()

    def choose(self, data: Data) -> Settings:
        """Return the option that does best when each participant in turn is left out."""
        whole = haart.cut(data.training, PUBLISHED_FRAMES)
        features = data.features(self.features, PUBLISHED_FRAMES, "training")
        scores = [left_out_accuracy(self.build(each, 0), features, whole) for each in self.options]
        best = int(np.argmax(scores))
        tried = [[str(option), round(score, 4)] for option, score in zip(self.options, scores, strict=True)]
        return {"settings": self.options[best], "left_out_accuracy": round(scores[best], 4), "tried": tried}

    def answers(
        self, data: Data, chosen: Settings, seed: int, lengths: Sequence[int]
    ) -> Iterator[tuple[int, Labels]]:
        """Train a classifier a length."""
        for frames in lengths:
            labels = haart.cut(data.training, frames).labels
            features = data.features(self.features, frames, "training")
            fitted = self.build(chosen["settings"], seed).fit(features, labels)
            named = fitted.predict(data.features(self.features, frames, "test"))
            yield frames, np.asarray(named, dtype=np.int64)


@dataclass(frozen=True)
class Searched(HandMade):
    """A forest on few features, searched for once, over whole recordings. names: of all the features."""

    names: tuple[str, ...] = field(kw_only=True)
    most: int = 10

    def choose(self, data: Data) -> Settings:
        """Return the features that the floating search ends with."""
        whole = haart.cut(data.training, PUBLISHED_FRAMES)
        features = data.features(self.features, PUBLISHED_FRAMES, "training")

        def worth(columns: tuple[int, ...]) -> float:
            forest = RandomForestClassifier(SEARCH_TREES, random_state=0)
            return left_out_accuracy(forest, features[:, columns], whole, SEARCH_FOLDS)

        found, score = floating_search(features.shape[1], self.most, worth)
        return {"settings": {"features": list(found)}, "left_out_accuracy": round(score, 4)}

    def in_words(self, settings: Settings) -> str:
        """Return the names of the features."""
        return ", ".join(self.names[feature] for feature in settings["features"])


@dataclass(frozen=True)
class Network(System):
    """One network for all lengths, trained on crops of whole recordings. most_epochs: what is chosen from."""

    most_epochs: int = 24

    def choose(self, data: Data) -> Settings:
        """Return the epochs after which two participants left out were answered best, smoothed over three."""
        training = haart.cut(haart.without(data.training, LEFT_OUT_OF_NETWORKS), PUBLISHED_FRAMES)
        left_out = haart.cut(haart.only(data.training, LEFT_OUT_OF_NETWORKS), PUBLISHED_FRAMES)
        with one_torch_thread():
            curve = [
                float((challenge_networks.answers(network, left_out.counts) == left_out.labels).mean())
                for network in challenge_networks.epochs(self.algorithm, training, 0, self.most_epochs)
            ]
        smooth = np.convolve(curve, np.ones(SMOOTHED_EPOCHS) / SMOOTHED_EPOCHS, mode="valid")
        epochs = int(smooth.argmax()) + SMOOTHED_EPOCHS
        return {
            "settings": {"epochs": epochs},
            "left_out_accuracy": round(float(smooth.max()), 4),
            "tried": [round(each, 4) for each in curve],
        }

    def answers(
        self, data: Data, chosen: Settings, seed: int, lengths: Sequence[int]
    ) -> Iterator[tuple[int, Labels]]:
        """Train once, and ask at every length."""
        whole = haart.cut(data.training, PUBLISHED_FRAMES)
        with one_torch_thread():
            *_, network = challenge_networks.epochs(self.algorithm, whole, seed, chosen["settings"]["epochs"])
            for frames in lengths:
                yield frames, challenge_networks.answers(network, haart.cut(data.test, frames).counts)


@dataclass(frozen=True)
class Shipped(System):
    """Our network, from its file of the seed; nothing is trained or chosen here."""

    def choose(self, data: Data) -> Settings:
        """Return nothing: everything was settled in training."""
        return {"settings": {}}

    def answers(
        self, data: Data, chosen: Settings, seed: int, lengths: Sequence[int]
    ) -> Iterator[tuple[int, Labels]]:
        """Ask the file at every length."""
        classifier = Classifier.load(model_files()[seed])
        for frames in lengths:
            counts = haart.cut(data.test, frames).counts
            named = [
                classifier.batch_probabilities(counts[start : start + ANSWER_BATCH]).argmax(axis=1)
                for start in range(0, len(counts), ANSWER_BATCH)
            ]
            yield frames, np.concatenate(named).astype(np.int64)


def left_out_accuracy(estimator: Any, features: Floats, windows: Windows, folds: int | None = None) -> float:
    """Return the accuracy on participants left out, one at a time, or in so many folds."""
    split = LeaveOneGroupOut() if folds is None else GroupKFold(folds)
    scores = cross_val_score(estimator, features, windows.labels, groups=windows.participants, cv=split)
    return float(scores.mean())
