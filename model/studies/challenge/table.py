"""The paper's table 1: the challenge's systems, reimplemented: `python -m touchd.model.studies challenge`.

Recordings are as published, not realigned; the training participants train, the test file tests. Settings
that a system's paper leaves open are chosen on whole training recordings of 432 frames, with people held out,
never on the test file. The challenge reported plain accuracy over whole recordings.
"""

import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from touchd.drivers.recording import Recording
from touchd.model.adapt.head import one_torch_thread
from touchd.model.classifier import Classifier
from touchd.model.studies.challenge import balli, gaus, hughes, ta
from touchd.model.studies.challenge.balli import SEARCH_TREES
from touchd.model.studies.challenge.features import forest
from touchd.model.studies.challenge.hughes import AUTOENCODER_RNN, CNN, CRNN
from touchd.model.studies.checks import evaluate
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.studies.published import TABLE3
from touchd.model.studies.results import STORED, Results, mean_percent
from touchd.model.training import haart, metrics
from touchd.model.training.haart import GESTURES, PUBLISHED_FRAMES, Windows
from touchd.model.training.metrics import Floats, Labels
from touchd.model.training.weights import touchd_1_files

FILE = STORED / "challenge.json"
LENGTHS = (432, 144, 81, 54)
SHOWN = (432, 144)
"""The page's columns: the challenge's length, and the figure's."""
SCORES = ("accuracy", "macro_accuracy")
HELD_OUT_OF_NETWORKS = ("P10", "P3")
SMOOTHED_EPOCHS = 3
SEARCH_FOLDS = 3
FRAMES = 144
"""The window length that the figure shows."""

Settings = dict[str, Any]
Features = Callable[[NDArray[np.uint16]], Floats]
Build = Callable[[Settings, int], Any]
"""Maps settings and a seed to an untrained scikit-learn classifier."""
Answer = Callable[[int], Labels]
"""Maps a window length to the answers to its test windows (N,)."""
Part = Literal["training", "test"]


class Data:
    """The recordings as published; each file is read, and each feature computed, once and when needed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._made: dict[tuple[Features, Part, int], Floats] = {}

    @cached_property
    def training(self) -> list[Recording]:
        """The training participants' recordings."""
        return haart.read_training(self.folder)

    @cached_property
    def test(self) -> list[Recording]:
        """The test participants' recordings."""
        return haart.read_test(self.folder)

    def windows(self, part: Part, frames: int = PUBLISHED_FRAMES) -> Windows:
        """Return one part's windows of a length."""
        return haart.cut(self.training if part == "training" else self.test, frames)

    def features(self, make: Features, part: Part, frames: int = PUBLISHED_FRAMES) -> Floats:
        """Return the features of one part's windows."""
        key = (make, part, frames)
        if key not in self._made:
            self._made[key] = make(self.windows(part, frames).counts)
        return self._made[key]


@dataclass(frozen=True)
class System(ABC):
    """A row of the table. key: its name among the results.

    published: accuracy on test in percent over whole recordings, if there is one. seeds: of its trainings;
    one for a deterministic system.
    """

    key: str
    researchers: str
    algorithm: str
    published: float | None
    seeds: tuple[int, ...] = (0, 1, 2)

    @abstractmethod
    def choose(self, data: Data) -> Settings:
        """Return the settings that score best on the training recordings, and their scores."""

    @abstractmethod
    def train(self, data: Data, settings: Settings, seed: int) -> Answer:
        """Return a function from a length to the answers to its test windows."""


@dataclass(frozen=True)
class HandMade(System):
    """Features and a scikit-learn classifier, trained for each length. options: candidate settings."""

    features: Features = field(kw_only=True)
    build: Build = field(kw_only=True)
    options: tuple[Settings, ...] = ()

    def choose(self, data: Data) -> Settings:
        """Return the option that scores best with each participant held out in turn."""
        whole, features = data.windows("training"), data.features(self.features, "training")
        scores = [held_out_accuracy(self.build(each, 0), features, whole) for each in self.options]
        best = int(np.argmax(scores))
        tried = [[str(option), round(score, 4)] for option, score in zip(self.options, scores, strict=True)]
        return {"settings": self.options[best], "left_out_accuracy": round(scores[best], 4), "tried": tried}

    def train(self, data: Data, settings: Settings, seed: int) -> Answer:
        def answer(frames: int) -> Labels:
            features = data.features(self.features, "training", frames)
            fitted = self.build(settings, seed).fit(features, data.windows("training", frames).labels)
            return np.asarray(fitted.predict(data.features(self.features, "test", frames)), dtype=np.int64)

        return answer


@dataclass(frozen=True)
class Searched(HandMade):
    """A forest on few features, selected once, on whole recordings. most: maximum number of features."""

    most: int = 10

    def choose(self, data: Data) -> Settings:
        """Return the features that the sequential forward floating search selects."""
        # mlxtend comes with the extra `studies` only; the other systems need just `train`.
        from mlxtend.feature_selection import SequentialFeatureSelector
        from sklearn.ensemble import RandomForestClassifier
        from sklearn.model_selection import GroupKFold

        search = SequentialFeatureSelector(
            RandomForestClassifier(SEARCH_TREES, random_state=0),
            k_features=(1, self.most),
            floating=True,
            scoring="accuracy",
            cv=GroupKFold(SEARCH_FOLDS),
        )
        whole = data.windows("training")
        search.fit(data.features(self.features, "training"), whole.labels, groups=whole.participants)
        found, score = sorted(search.k_feature_idx_), search.k_score_
        return {"settings": {"features": found}, "left_out_accuracy": round(score, 4)}


@dataclass(frozen=True)
class DeepSystem(System):
    """One network for all lengths, trained on crops of whole recordings. most_epochs: epochs to try."""

    most_epochs: int = 24

    def choose(self, data: Data) -> Settings:
        """Return the number of epochs with the best accuracy, smoothed over three, on two people held out."""
        training = haart.cut(haart.without(data.training, HELD_OUT_OF_NETWORKS), PUBLISHED_FRAMES)
        held_out = haart.cut(haart.only(data.training, HELD_OUT_OF_NETWORKS), PUBLISHED_FRAMES)
        curve = [
            float((hughes.answers(network, held_out.counts) == held_out.labels).mean())
            for network in hughes.epochs(self.algorithm, training, 0, self.most_epochs)
        ]
        smooth = np.convolve(curve, np.ones(SMOOTHED_EPOCHS) / SMOOTHED_EPOCHS, mode="valid")
        return {
            "settings": {"epochs": int(smooth.argmax()) + SMOOTHED_EPOCHS},
            "left_out_accuracy": round(float(smooth.max()), 4),
            "tried": [round(each, 4) for each in curve],
        }

    def train(self, data: Data, settings: Settings, seed: int) -> Answer:
        whole = data.windows("training")
        *_, network = hughes.epochs(self.algorithm, whole, seed, settings["epochs"])
        return lambda frames: hughes.answers(network, data.windows("test", frames).counts)


@dataclass(frozen=True)
class Shipped(System):
    """touchd-1, from the file of the seed; nothing is trained or chosen here."""

    def choose(self, data: Data) -> Settings:
        return {"settings": {}}

    def train(self, data: Data, settings: Settings, seed: int) -> Answer:
        classifier = Classifier.load(touchd_1_files()[seed])
        return lambda frames: evaluate.answer(classifier, data.windows("test", frames).counts).argmax(axis=1)


def held_out_accuracy(estimator: Any, features: Floats, windows: Windows) -> float:
    """Return the mean accuracy on each participant held out in turn."""
    from sklearn.model_selection import LeaveOneGroupOut, cross_val_score

    people, one_out = windows.participants, LeaveOneGroupOut()
    return float(cross_val_score(estimator, features, windows.labels, groups=people, cv=one_out).mean())


BALLI = "Balli Altuglu and Altun 2015"
TA = "Ta et al. 2015"
GAUS = "Gaus et al. 2015"
HUGHES = "Hughes et al. 2017"
FOREST, BOOSTING = "random forest", "multiboosting"

SYSTEMS: tuple[System, ...] = (
    Searched("balli-forest", BALLI, FOREST, 61.5, features=balli.features, build=balli.forest),
    HandMade("ta-forest", TA, FOREST, 70.9, features=ta.features, build=forest, options=ta.FORESTS),
    HandMade("ta-svm", TA, "SVM", 68.5, (0,), features=ta.features, build=ta.machine, options=ta.MACHINES),
    HandMade("gaus-forest", GAUS, FOREST, 66.5, features=gaus.features, build=forest, options=gaus.FORESTS),
    HandMade(
        "gaus-boosting",
        GAUS,
        BOOSTING,
        64.5,
        features=gaus.features,
        build=gaus.boosting,
        options=gaus.BOOSTS,
    ),
    DeepSystem("hughes-cnn", HUGHES, CNN, 56.1),
    DeepSystem("hughes-crnn", HUGHES, CRNN, 61.4),
    DeepSystem("hughes-autoencoder", HUGHES, AUTOENCODER_RNN, 61.4, most_epochs=40),
    Shipped("touchd", "touchd-1", "one causal network", None),
)


def main(arguments: Sequence[str]) -> int:
    """Train and score what is not stored yet, then fill the table and draw the figure; returns 0."""
    parser = study_parser("challenge", "Reimplements the challenge's systems.", "haart", "docs")
    options = parser.parse_args(arguments)
    results = Results(FILE)
    run(results, Data(options.haart))
    page = options.docs / "report.md"
    fill(page, tables(results))
    draw(results, options.docs / "figures" / "report-challenge.png")
    sys.stdout.write(f"{page}\n")
    return 0


def run(results: Results, data: Data) -> None:
    """Choose settings, train and score whatever the results lack."""
    for system in SYSTEMS:
        for seed in system.seeds:
            missing = [each for each in LENGTHS if not results.has(cell_key(system, each, seed))]
            if missing:
                with one_torch_thread():
                    measure(results, data, system, seed, missing)


def measure(results: Results, data: Data, system: System, seed: int, lengths: Sequence[int]) -> None:
    """Add the cells of these lengths; settings are chosen once per system."""
    began = time.perf_counter()
    if not results.has(chosen_key(system)):
        results.put(chosen_key(system), system.choose(data), time.perf_counter() - began)
        began = time.perf_counter()
    answer = system.train(data, results.get(chosen_key(system))["settings"], seed)
    for frames in lengths:
        named, labels = answer(frames), data.windows("test", frames).labels
        answers = "".join(map(str, named.tolist()))
        values = {**scores(named, labels), "windows": len(labels), "answers": answers}
        results.put(cell_key(system, frames, seed), values, time.perf_counter() - began)
        began = time.perf_counter()


def scores(named: Labels, labels: Labels) -> dict[str, float]:
    """Return plain and macro accuracy of the answers (N,) to windows with these labels (N,)."""
    return {
        "accuracy": round(float((named == labels).mean()), 5),
        "macro_accuracy": round(metrics.macro_accuracy(named, labels, len(GESTURES)), 5),
    }


def cell_key(system: System, frames: int, seed: int) -> str:
    """Return a cell's key; cells hold the window count, both accuracies, and answers, a digit per window."""
    return f"{system.key}/frames{frames}/seed{seed}"


def chosen_key(system: System) -> str:
    """Return the key of a system's chosen settings."""
    return f"{system.key}/chosen"


def scores_of(results: Results, key: str, frames: int, score: str = "accuracy") -> list[float]:
    """Return a score of each training of the system with that key."""
    return [results.get(cell)[score] for cell in results.find(f"{key}/frames{frames}/seed")]


def tables(results: Results) -> dict[str, str]:
    """Return the table: plain accuracy as published, and of the reimplementations at each length."""
    headings = ("system", "published", *(f"{frames} frames" for frames in SHOWN))
    rows: list[tuple[object, ...]] = [
        (
            f"{system.researchers}, {system.algorithm}",
            system.published or "",
            *(mean_percent(scores_of(results, system.key, frames)) for frames in SHOWN),
        )
        for system in SYSTEMS
    ]
    paper = (f"Ren et al. 2023, TGC ({FRAMES} frames)", TABLE3[FRAMES], *[""] * len(SHOWN))
    return {"table1": table(headings, [*rows, paper])}


def draw(results: Results, path: Path) -> None:
    """Draw each system's published accuracy, and that of its reimplementation over 2.67 s."""
    figure = Figure(figsize=(7.2, 3.8), layout="constrained")
    axes = figure.subplots()
    places = np.arange(len(SYSTEMS))[::-1]
    for place, system in zip(places, SYSTEMS, strict=True):
        own = 100 * float(np.mean(scores_of(results, system.key, FRAMES)))
        if system.published:
            axes.plot((system.published, own), (place, place), color="0.8", linewidth=3, zorder=0)
            axes.plot(system.published, place, "kD", fillstyle="none")
        axes.plot(own, place, "o", color="#1f5fa8")
    axes.axvline(TABLE3[FRAMES], color="#c4611a", linestyle=":")
    top = len(SYSTEMS) - 0.4
    axes.annotate("the paper's TGC, 2.67 s", (TABLE3[FRAMES] + 0.4, top), color="#c4611a", fontsize=8)
    first = SYSTEMS[0]
    axes.annotate(
        "published, 8 s", (first.published or 0.0, top - 0.35), ha="center", va="bottom", fontsize=8
    )
    last = 100 * float(np.mean(scores_of(results, SYSTEMS[-1].key, FRAMES)))
    axes.annotate(
        "measured here, 2.67 s", (last, 0.25), ha="center", va="bottom", color="#1f5fa8", fontsize=8
    )
    axes.set_yticks(places, [f"{system.researchers}, {system.algorithm}" for system in SYSTEMS], fontsize=8)
    axes.set(xlabel="accuracy on the challenge's test participants, %", xlim=(44, 90), ylim=(-0.6, top + 0.4))
    axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
