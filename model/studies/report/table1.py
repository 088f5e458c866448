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
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import GroupKFold, LeaveOneGroupOut, cross_val_score

from touchd.drivers.recording import Recording
from touchd.model.adapt.threads import one_torch_thread
from touchd.model.classifier import Classifier
from touchd.model.studies.accuracy import PAPER_ACCURACY
from touchd.model.studies.checks import evaluate
from touchd.model.studies.marked import table
from touchd.model.studies.report import challenge_balli as balli
from touchd.model.studies.report import challenge_gaus as gaus
from touchd.model.studies.report import challenge_hughes
from touchd.model.studies.report import challenge_ta as ta
from touchd.model.studies.report.challenge_balli import SEARCH_TREES
from touchd.model.studies.report.challenge_features import forest
from touchd.model.studies.report.challenge_hughes import AUTOENCODER_RNN, CNN, CRNN
from touchd.model.studies.report.paper_cells import PAPER_EPOCHS, accuracies, describe, trained
from touchd.model.studies.report.results import Results, Study, percent
from touchd.model.studies.report.tables23 import model_files
from touchd.model.training import haart, metrics
from touchd.model.training.haart import GESTURES, PUBLISHED_FRAMES, Windows
from touchd.model.training.metrics import Floats, Labels

PREFIX = "table1/"
LENGTHS = (432, 144, 81, 54)
SCORES = ("accuracy", "macro_accuracy")
PAPER_TGC = PAPER_ACCURACY[144]
LEFT_OUT_OF_NETWORKS = ("P10", "P3")
SMOOTHED_EPOCHS = 3
SEARCH_FOLDS = 3

Settings = dict[str, Any]
Features = Callable[[NDArray[np.uint16]], Floats]
Build = Callable[[Settings, int], Any]
"""Settings and seed to an untrained classifier of scikit-learn."""
Answer = Callable[[int], Labels]
"""A length to the class named for each of its test windows (N,)."""
Part = Literal["training", "test"]


class Data:
    """The recordings as published, each file read when first asked for; features are made once."""

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
    def train(self, data: Data, settings: Settings, seed: int) -> Answer:
        """Return what answers the test windows of each length."""

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
        whole, features = data.windows("training"), data.features(self.features, "training")
        scores = [left_out_accuracy(self.build(each, 0), features, whole) for each in self.options]
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
    """A forest on few features, searched for once, over whole recordings. most: how many at most."""

    most: int = 10

    def choose(self, data: Data) -> Settings:
        """Return the features that the floating search ends with."""
        # Not in the extra `train`, which is enough for all else.
        from mlxtend.feature_selection import SequentialFeatureSelector

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

    def in_words(self, settings: Settings) -> str:
        """Return the names of the features."""
        return ", ".join(balli.NAMES[feature] for feature in settings["features"])


@dataclass(frozen=True)
class DeepSystem(System):
    """One network for all lengths, trained on crops of whole recordings. most_epochs: most to try."""

    most_epochs: int = 24

    def choose(self, data: Data) -> Settings:
        """Return the epochs after which two participants left out were answered best, smoothed over three."""
        training = haart.cut(haart.without(data.training, LEFT_OUT_OF_NETWORKS), PUBLISHED_FRAMES)
        left_out = haart.cut(haart.only(data.training, LEFT_OUT_OF_NETWORKS), PUBLISHED_FRAMES)
        curve = [
            float((challenge_hughes.answers(network, left_out.counts) == left_out.labels).mean())
            for network in challenge_hughes.epochs(self.algorithm, training, 0, self.most_epochs)
        ]
        smooth = np.convolve(curve, np.ones(SMOOTHED_EPOCHS) / SMOOTHED_EPOCHS, mode="valid")
        return {
            "settings": {"epochs": int(smooth.argmax()) + SMOOTHED_EPOCHS},
            "left_out_accuracy": round(float(smooth.max()), 4),
            "tried": [round(each, 4) for each in curve],
        }

    def train(self, data: Data, settings: Settings, seed: int) -> Answer:
        whole = data.windows("training")
        *_, network = challenge_hughes.epochs(self.algorithm, whole, seed, settings["epochs"])
        return lambda frames: challenge_hughes.answers(network, data.windows("test", frames).counts)


@dataclass(frozen=True)
class Shipped(System):
    """Our network, from its file of the seed; nothing is trained or chosen here."""

    def choose(self, data: Data) -> Settings:
        return {"settings": {}}

    def train(self, data: Data, settings: Settings, seed: int) -> Answer:
        classifier = Classifier.load(model_files()[seed])
        return lambda frames: evaluate.answer(classifier, data.windows("test", frames).counts).argmax(axis=1)


def left_out_accuracy(estimator: Any, features: Floats, windows: Windows) -> float:
    """Return the accuracy on participants left out one at a time."""
    people, one_out = windows.participants, LeaveOneGroupOut()
    return float(cross_val_score(estimator, features, windows.labels, groups=people, cv=one_out).mean())


BALLI = "Balli Altuglu and Altun 2015"
TA = "Ta et al. 2015"
GAUS = "Gaus et al. 2015"
HUGHES = "Hughes et al. 2017"
FOREST, BOOSTING = "Random forest", "Multiboosting"

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
                with one_torch_thread():
                    measure(study.results, data, system, seed, missing)


def measure(results: Results, data: Data, system: System, seed: int, lengths: Sequence[int]) -> None:
    """Add the cells of these lengths; what is chosen is chosen once a system."""
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
    rows, chosen = [], []
    for system in SYSTEMS:
        who = (system.researchers, system.algorithm)
        scored = [scores_of(results, system.key, *each) for each in product(LENGTHS, SCORES)]
        rows.append((*who, system.published or "", *(percent(each) or "not run" for each in scored)))
        found = results.get(chosen_key(system)) if results.has(chosen_key(system)) else {"settings": {}}
        if found["settings"]:
            left_out = f"{100 * found['left_out_accuracy']:.1f}"
            chosen.append((*who, system.in_words(found["settings"]), left_out))
    return {
        "table1": table(headings, [*rows, *_paper_rows(results)]),
        "table1-chosen": table(("researchers", "classifier", "chosen", "left out"), chosen),
    }


def _paper_rows(results: Results) -> Iterator[Sequence[object]]:
    yield "Ren et al. 2023", "TGC, Transformer", f"{PAPER_TGC} (144 frames)", *[""] * 2 * len(LENGTHS)
    networks = trained(results)
    shapes = {(variant, blocks) for variant, blocks, _ in networks}
    for variant, blocks in sorted(shapes, key=lambda shape: (shape[0] != "public", -shape[1])):
        found = [networks.get((variant, blocks, frames), []) for frames in LENGTHS]
        last = [
            f"{percent([accuracies(results, cell)[-1] for cell in cells])} "
            f"(epoch {cells[0].epochs} of {PAPER_EPOCHS})"
            if cells
            else ""
            for cells in found
        ]
        if any(last):
            cells_of_row = [cell for each in last for cell in ("", each)]
            yield "Ren et al., made again", f"TGC, {describe(variant, blocks)}", "", *cells_of_row


def draw(results: Results, figures: Path) -> None:
    """Draw a line a system: what was published, and what ours gives at each length, with its spread."""
    figure = Figure(figsize=(7.4, 5.2), layout="constrained")
    axes = figure.subplots()
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
