"""The paper's table 1: the challenge's systems as published, and reimplemented from their descriptions.

Recordings as published, not realigned; training participants train, the test file tests. Settings that a
paper leaves open are chosen on whole training recordings of 432 frames, by leaving participants out, never on
the test file. The challenge reported plain accuracy over whole recordings.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import GroupKFold, LeaveOneGroupOut, cross_val_score

from docs.studies.marked import table
from docs.studies.report import challenge_balli as balli
from docs.studies.report import challenge_gaus as gaus
from docs.studies.report import challenge_hughes
from docs.studies.report import challenge_ta as ta
from docs.studies.report.challenge_balli import SEARCH_TREES
from docs.studies.report.challenge_hughes import AUTOENCODER_RNN, CNN, CRNN
from docs.studies.report.paper_cells import PAPER_EPOCHS, Variant, describe, trained_cells, trained_networks
from docs.studies.report.results import Results, Study, percent
from docs.studies.report.tables23 import accuracies, model_files
from docs.studies.training import haart, metrics
from docs.studies.training.haart import GESTURES, PUBLISHED_FRAMES, Windows
from docs.studies.training.metrics import Floats, Labels
from drivers.recording import Recording
from model.classifier import Classifier
from model.training.threads import one_torch_thread

PREFIX = "table1/"
LENGTHS = (432, 144, 81, 54)
SCORES = ("accuracy", "macro_accuracy")
PAPER_TGC = 72.8
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
        """Return the settings that do best on the training recordings, and their scores."""

    @abstractmethod
    def answers(
        self, data: Data, chosen: Settings, seed: int, lengths: Sequence[int]
    ) -> Iterator[tuple[int, Labels]]:
        """Train, and yield each length with the class named for each test window (N,)."""

    def in_words(self, settings: Settings) -> str:
        """Return chosen settings in words."""
        return ", ".join(f"{name} {value}" for name, value in settings.items())


@dataclass(frozen=True)
class HandMade(System):
    """Features and a scikit-learn classifier, trained once a length. options: the candidates."""

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

        # Not in the extra `train`, which is enough for all else.
        from mlxtend.feature_selection import SequentialFeatureSelector

        search = SequentialFeatureSelector(
            RandomForestClassifier(SEARCH_TREES, random_state=0),
            k_features=(1, self.most),
            floating=True,
            scoring="accuracy",
            cv=GroupKFold(SEARCH_FOLDS),
        )
        search.fit(features, whole.labels, groups=whole.participants)
        found, score = sorted(search.k_feature_idx_), search.k_score_
        return {"settings": {"features": found}, "left_out_accuracy": round(score, 4)}

    def in_words(self, settings: Settings) -> str:
        """Return the names of the features."""
        return ", ".join(self.names[feature] for feature in settings["features"])


@dataclass(frozen=True)
class DeepSystem(System):
    """One network for all lengths, trained on crops of whole recordings. most_epochs: most to try."""

    most_epochs: int = 24

    def choose(self, data: Data) -> Settings:
        """Return the epochs after which two participants left out were answered best, smoothed over three."""
        training = haart.cut(haart.without(data.training, LEFT_OUT_OF_NETWORKS), PUBLISHED_FRAMES)
        left_out = haart.cut(haart.only(data.training, LEFT_OUT_OF_NETWORKS), PUBLISHED_FRAMES)
        with one_torch_thread():
            curve = [
                float((challenge_hughes.answers(network, left_out.counts) == left_out.labels).mean())
                for network in challenge_hughes.epochs(self.algorithm, training, 0, self.most_epochs)
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
            *_, network = challenge_hughes.epochs(self.algorithm, whole, seed, chosen["settings"]["epochs"])
            for frames in lengths:
                yield frames, challenge_hughes.answers(network, haart.cut(data.test, frames).counts)


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


def left_out_accuracy(estimator: Any, features: Floats, windows: Windows) -> float:
    """Return the accuracy on participants left out one at a time."""
    people = windows.participants
    return float(
        cross_val_score(estimator, features, windows.labels, groups=people, cv=LeaveOneGroupOut()).mean()
    )


BALLI = "Balli Altuglu and Altun 2015"
TA = "Ta et al. 2015"
GAUS = "Gaus et al. 2015"
HUGHES = "Hughes et al. 2017"
FOREST = "Random forest"

SYSTEMS: tuple[System, ...] = (
    Searched(
        "balli-forest", BALLI, FOREST, 61.5, features=balli.features, build=balli.forest, names=balli.NAMES
    ),
    HandMade("ta-forest", TA, FOREST, 70.9, features=ta.features, build=ta.forest, options=ta.FORESTS),
    HandMade("ta-svm", TA, "SVM", 68.5, (0,), features=ta.features, build=ta.machine, options=ta.MACHINES),
    HandMade(
        "gaus-forest", GAUS, FOREST, 66.5, features=gaus.features, build=gaus.forest, options=gaus.FORESTS
    ),
    HandMade(
        "gaus-boosting",
        GAUS,
        "Multiboosting",
        64.5,
        features=gaus.features,
        build=gaus.boosting,
        options=gaus.BOOSTS,
    ),
    DeepSystem("hughes-cnn", HUGHES, CNN, 56.1),
    DeepSystem("hughes-crnn", HUGHES, CRNN, 61.4),
    DeepSystem("hughes-autoencoder", HUGHES, AUTOENCODER_RNN, 61.4, most_epochs=40),
    Shipped("touchd", "touchd", "One causal network", None),
)


def run(study: Study) -> None:
    """Choose, train and score what the results lack."""
    data = Data(study.haart)
    # Systems without training come first, so that a run cut short has them.
    for system in sorted(SYSTEMS, key=lambda system: not isinstance(system, Shipped)):
        for seed in system.seeds:
            missing = [each for each in LENGTHS if not study.results.has(cell_key(system, each, seed))]
            if missing:
                measure(study.results, data, system, seed, missing)


def measure(results: Results, data: Data, system: System, seed: int, lengths: Sequence[int]) -> None:
    """Add the cells of these lengths; what is chosen is chosen once a system."""
    began = time.perf_counter()
    if not results.has(chosen_key(system)):
        results.put(chosen_key(system), system.choose(data), time.perf_counter() - began)
        began = time.perf_counter()
    for frames, named in system.answers(data, results.get(chosen_key(system)), seed, lengths):
        labels = haart.cut(data.test, frames).labels
        values = {
            **scores(named, labels),
            "windows": len(labels),
            "answers": "".join(map(str, named.tolist())),
        }
        results.put(cell_key(system, frames, seed), values, time.perf_counter() - began)
        began = time.perf_counter()


def scores(named: Labels, labels: Labels) -> dict[str, float]:
    """Return the plain and the macro accuracy of the classes named (N,) for windows of these labels (N,)."""
    return {
        "accuracy": round(float((named == labels).mean()), 5),
        "macro_accuracy": round(metrics.macro_accuracy(named, labels, len(GESTURES)), 5),
    }


def cell_key(system: System, frames: int, seed: int) -> str:
    """Return the key of a cell: values windows, accuracy, macro_accuracy and answers, a digit a window."""
    return f"{PREFIX}{system.key}/frames{frames}/seed{seed}"


def chosen_key(system: System) -> str:
    """Return the key of a system's chosen settings."""
    return f"{PREFIX}{system.key}/chosen"


def scores_of(results: Results, key: str, frames: int, score: str) -> list[float]:
    """Return a score, "accuracy" or "macro_accuracy", of each seed of the system of that key."""
    return [results.get(cell)[score] for cell in results.keys(f"{PREFIX}{key}/frames{frames}/seed")]


def tables(results: Results) -> dict[str, str]:
    """Return the table, and what was chosen on training participants who were left out."""
    headings = ["researchers", "classifier", "published"]
    for frames in LENGTHS:
        headings += [f"{frames} frames", "macro"]
    rows = []
    for system in SYSTEMS:
        row = [
            system.researchers,
            system.algorithm,
            "" if system.published is None else f"{system.published:.1f}",
        ]
        for frames in LENGTHS:
            row += [percent(scores_of(results, system.key, frames, score)) or "not run" for score in SCORES]
        rows.append(row)
    chosen = []
    for system in SYSTEMS:
        if results.has(chosen_key(system)) and results.get(chosen_key(system))["settings"]:
            found = results.get(chosen_key(system))
            left_out = f"{100 * found['left_out_accuracy']:.1f}"
            words = system.in_words(found["settings"])
            chosen.append((system.researchers, system.algorithm, words, left_out))
    return {
        "table1": table(headings, [*rows, *_paper_rows(results)]),
        "table1-chosen": table(("researchers", "classifier", "chosen", "left out"), chosen),
    }


def _paper_rows(results: Results) -> Iterator[list[str]]:
    empty = [""] * 2 * len(LENGTHS)
    yield ["Ren et al. 2023", "TGC, Transformer", f"{PAPER_TGC} (144 frames)", *empty]
    networks = {(variant, blocks) for variant, blocks, _ in trained_networks(results)}
    for variant, blocks in sorted(networks, key=lambda network: (network[0] != "public", -network[1])):
        row = ["Ren et al., made again", f"TGC, {describe(variant, blocks)}", ""]
        for frames in LENGTHS:
            row += ["", _last_epoch(results, variant, blocks, frames)]
        if any(row[3:]):
            yield row


def _last_epoch(results: Results, variant: Variant, blocks: int, frames: int) -> str:
    cells = trained_cells(results, variant, blocks, frames)
    if not cells:
        return ""
    last = percent([accuracies(results, cell)[-1] for cell in cells])
    return f"{last} (epoch {cells[0].epochs} of {PAPER_EPOCHS})"


def draw(results: Results, figures: Path) -> None:
    """Draw a line a system: what was published, and what ours gives at each length, with its spread."""
    figure, axes = plt.subplots(figsize=(7.4, 5.2), layout="constrained")
    places = np.arange(len(SYSTEMS))[::-1]
    for number, frames in enumerate(LENGTHS):
        for place, system in zip(places, SYSTEMS, strict=True):
            values = [100 * value for value in scores_of(results, system.key, frames, "accuracy")]
            if values:
                spread = np.std(values, ddof=1) if len(values) > 1 else 0.0
                label = f"ours, {frames} frames" if system is SYSTEMS[0] else None
                lower = place - 0.13 * (number - (len(LENGTHS) - 1) / 2)
                axes.errorbar(np.mean(values), lower, xerr=spread, fmt="o", color=f"C{number}", label=label)
    known = [
        (system.published, place) for place, system in zip(places, SYSTEMS, strict=True) if system.published
    ]
    axes.plot(*zip(*known, strict=True), "kD", fillstyle="none", label="published, 432 frames")
    axes.axvline(PAPER_TGC, color="grey", linestyle=":", label="TGC as published, 144 frames")
    axes.set_yticks(places, [f"{system.researchers}, {system.algorithm}" for system in SYSTEMS], fontsize=8)
    axes.set(xlabel="accuracy on test, %")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    figure.savefig(figures / "report-challenge.png", dpi=120)
    plt.close(figure)
