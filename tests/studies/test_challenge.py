"""The challenge's systems: features, training, and stored figures."""

import dataclasses
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.haart_folder import HAART, haart_test_without_counts, needs_haart

pytest.importorskip("torch", reason="needs the extra `train`")
if find_spec("sklearn") is None:
    pytest.skip("needs the extra `studies`", allow_module_level=True)

import torch

from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.adapt.optimise import one_torch_thread
from touchd.model.studies.challenge import balli, features, gaus, hughes, ta, table
from touchd.model.studies.challenge.table import (
    SYSTEMS,
    Data,
    DeepSystem,
    HandMade,
    Searched,
    Shipped,
    System,
)
from touchd.model.studies.results import Results
from touchd.model.training import haart

RESULTS = Results(table.FILE)
CELLS = [key for key in RESULTS.find() if "/seed" in key]
REFIT = ("balli-forest", "ta-forest", "ta-svm", "gaus-boosting", "hughes-autoencoder")
TOLERANCE = 0.02
"""For a refit: another processor or scikit-learn rounds differently, and trees split on the last digit."""
HZ = 54.0
FEATURES = {ta.features: 273, balli.features: 81, gaus.features: 724}


def pressed(series: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a pad (1, L, 8, 8) with equal pressure on every taxel."""
    return np.broadcast_to(series[np.newaxis, :, np.newaxis, np.newaxis], (1, len(series), 8, 8))


def sine(frames: int, hz: float) -> NDArray[np.float64]:
    phase = 2.0 * np.pi * hz * np.arange(frames, dtype=np.float64) / HZ - 0.3
    return np.asarray(100.0 + 50.0 * np.sin(phase))


@pytest.mark.parametrize("frames", [54, 432])
def test_three_taps_a_second_are_found(frames: int) -> None:
    pressure = features.mean_pressure(pressed(sine(frames, 3.0)))
    assert features.crossings(pressure) == pytest.approx([3.0], abs=0.13)
    assert features.rhythm(pressure)[0, 0] == pytest.approx(3.0)
    power = features.bands(pressure, np.array([0.0, 2.5, 3.5, 10.0]))[0]
    assert power == pytest.approx([0.0, 50.0**2, 0.0], abs=1e-6)


def test_a_finger_that_walks_diagonally_is_followed_taxel_by_taxel() -> None:
    counts = np.zeros((1, 8, 8, 8))
    for place in range(8):
        counts[0, place, place, place] = 300.0
    path = features.centroid(counts)
    assert path[0] == pytest.approx(np.stack([np.arange(8.0), np.arange(8.0)], axis=1))
    assert features.steps(path) == pytest.approx(np.full((1, 7), np.sqrt(2.0)))
    assert features.centroid(np.zeros((1, 1, 8, 8)))[0, 0].tolist() == [3.5, 3.5]


of_each_system = pytest.mark.parametrize(
    "make", FEATURES, ids=lambda make: make.__module__.rpartition(".")[2]
)


@pytest.mark.parametrize("frames", [54, 144, 432])
@pytest.mark.parametrize("level", [0, 7, 1023])
@of_each_system
def test_a_pad_on_which_nothing_moves_has_all_its_features(make: Any, level: int, frames: int) -> None:
    made_features = make(np.full((2, frames, 8, 8), level, dtype=np.uint16))
    assert made_features.shape == (2, FEATURES[make])
    assert np.isfinite(made_features).all()


@of_each_system
def test_features_do_not_depend_on_other_windows(make: Any) -> None:
    counts = np.random.default_rng(0).integers(500, size=(3, 54, 8, 8)).astype(np.uint16)
    assert make(counts)[1] == pytest.approx(make(counts[1:2])[0])


def test_each_candidate_feature_has_a_name_at_its_place() -> None:
    values = balli.features(pressed(sine(432, 3.0)).astype(np.uint16))[0]
    named = dict(zip(balli.NAMES, values, strict=True))
    assert len(named) == FEATURES[balli.features]
    assert named["image's row"] == named["mean of column"] == pytest.approx(3.5)
    assert named["greatest of greatest count"] == 149.0
    assert named["mean of touched area"] == 1.0
    assert named["mobility of mean pressure"] == pytest.approx(2.0 * np.sin(np.pi * 3.0 / HZ), rel=0.05)


def test_a_moving_taxel_shows_in_every_scale() -> None:
    moving = np.zeros((1, 40, 8, 8), dtype=bool)
    for start in (3, 13, 23):
        moving[0, start : start + 2, 5, 6] = True
    history = gaus.motion_history(moving)[0]
    parts = np.split(history, [5 * 64, 5 * 64 + 5 * 16])
    for histogram, side, row, column in zip(parts, (8, 4, 2), (5, 2, 1), (6, 3, 1), strict=True):
        expected = np.zeros((5, side, side))
        expected[1, row, column] = 3 / 40
        assert histogram == pytest.approx(expected.ravel())


KINDS = (hughes.CNN, hughes.CRNN, hughes.AUTOENCODER_RNN)


@pytest.mark.parametrize("kind", KINDS)
def test_one_network_answers_six_times_a_second_at_every_length(kind: str) -> None:
    network = hughes.HughesNetwork(kind, 7).eval()
    for frames in table.LENGTHS:
        counts = torch.randint(500, (2, frames, 8, 8)).float()
        steps = frames // 9 - (4 if kind == hughes.CNN else 0)
        assert network(counts).shape == (2, steps, 7)
        assert network.answer(counts).shape == (2, 7)


def made(participants: Sequence[str]) -> list[Recording]:
    """Return made-up recordings of a still pad, a tapped one and a busy one."""
    rng = np.random.default_rng(len(participants))
    recordings = []
    for participant in participants:
        tapped = np.where(sine(432, 3.0) > 120.0, 200, 5)[:, np.newaxis, np.newaxis]
        for gesture, level in (("notouch", 3), ("pat", tapped), ("rub", 150)):
            counts = rng.poisson(np.broadcast_to(level, (432, 8, 8))).astype(np.uint16)
            clock = ideal_clock_ms(432)
            recordings.append(Recording(participant, "foam", "fur", gesture, counts, clock, "published"))
    return recordings


class MadeUp(Data):
    """Made-up recordings instead of a folder's; the test part can be left out."""

    def __init__(self, with_test: bool = True) -> None:
        super().__init__(Path("nowhere"))
        self.training = made(("P10", "P3", "P5", "P6"))
        if with_test:
            self.test = made(("T1", "T2"))


def few_features(counts: NDArray[np.uint16]) -> NDArray[np.float64]:
    return balli.features(counts)[:, :4]


def small(system: System) -> System:
    """Return a quicker variant of a system."""
    if isinstance(system, Searched):
        return dataclasses.replace(system, most=1, features=few_features)
    if isinstance(system, HandMade):
        return dataclasses.replace(system, options=system.options[-1:])
    return dataclasses.replace(system, most_epochs=3)


TRAINED = [system for system in SYSTEMS if not isinstance(system, Shipped)]


@pytest.fixture(autouse=True)
def _small_trainings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(features, "TREES", 10)
    monkeypatch.setattr(table, "SEARCH_TREES", 2)
    monkeypatch.setattr(hughes, "AUTOENCODER_STEPS", 50)
    monkeypatch.setattr(hughes, "CROP_FRAMES", 54)


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "system",
    [
        pytest.param(each, marks=[pytest.mark.slow] * (each.key not in ("gaus-forest", "gaus-boosting")))
        for each in TRAINED
    ],
    ids=lambda system: system.key,
)
def test_settings_are_chosen_without_the_test_file(system: System) -> None:
    chosen = small(system).choose(MadeUp(with_test=False))
    assert chosen["settings"]
    assert 0.0 <= chosen["left_out_accuracy"] <= 1.0


@pytest.mark.parametrize(
    "system",
    [pytest.param(each, marks=[pytest.mark.slow] * isinstance(each, DeepSystem)) for each in TRAINED],
    ids=lambda system: system.key,
)
def test_a_system_learns_reproducibly(system: System) -> None:
    data = MadeUp()
    settings: dict[str, Any] = {"features": [0, 1, 6, 7]}
    if isinstance(system, DeepSystem):
        settings = {"epochs": 12}
    elif isinstance(system, HandMade) and not isinstance(system, Searched):
        settings = system.options[-1]
    with one_torch_thread():
        named, again = (system.train(data, settings, 1)(54) for _ in range(2))
    assert named.tolist() == again.tolist()
    assert table.scores(named, haart.cut(data.test, 54).labels)["accuracy"] > 0.9


@dataclasses.dataclass(frozen=True)
class Counted(System):
    """A system that answers "constant" to everything and records what it was asked."""

    asked: list[tuple[int, int]] = dataclasses.field(default_factory=list)

    def choose(self, data: Data) -> dict[str, Any]:
        return {"settings": {"any": 1}, "left_out_accuracy": 0.5}

    def train(self, data: Data, settings: dict[str, Any], seed: int) -> table.Answer:
        def answer(frames: int) -> NDArray[np.int64]:
            self.asked.append((seed, frames))
            return np.zeros(len(data.windows("test", frames).labels), dtype=np.int64)

        return answer


def test_a_second_run_trains_only_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    system = Counted("counted", "no one", "none", None, seeds=(0, 1))
    monkeypatch.setattr(table, "SYSTEMS", (system,))
    results = Results(tmp_path / "challenge.json")
    present = table.cell_key(system, 144, 1)
    results.put(present, {"accuracy": 0.25}, 1.0)
    table.run(results, MadeUp())
    table.run(results, MadeUp())
    assert system.asked == [(0, 432), (0, 144), (0, 81), (0, 54), (1, 432), (1, 81), (1, 54)]
    assert results.get(present) == {"accuracy": 0.25}
    cell = results.get(table.cell_key(system, 432, 0))
    assert cell == {"windows": 6, "accuracy": 0.0, "macro_accuracy": 0.0, "answers": "000000"}


@needs_haart
def test_every_stored_figure_is_that_of_the_stored_answers() -> None:
    recordings = haart_test_without_counts()
    labels = {frames: haart.cut(recordings, frames).labels for frames in table.LENGTHS}
    assert CELLS
    for key in CELLS:
        cell = RESULTS.get(key)
        truth = labels[int(key.split("/")[1].removeprefix("frames"))]
        assert cell["windows"] == len(truth)
        stored = {name: cell[name] for name in table.SCORES}
        assert table.scores(np.array(list(cell["answers"]), dtype=np.int64), truth) == stored, key


@pytest.fixture(scope="module")
def recordings() -> Data:
    return Data(Path(str(HAART)))


@needs_haart
@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("key", REFIT)
def test_a_system_trained_again_still_gives_its_figure(
    key: str, recordings: Data, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    system = next(system for system in SYSTEMS if system.key == key)
    chosen = RESULTS.get(table.chosen_key(system))
    with one_torch_thread():
        named = system.train(recordings, chosen["settings"], 0)(432)
    stored = RESULTS.get(table.cell_key(system, 432, 0))
    measured = table.scores(named, haart.cut(recordings.test, 432).labels)
    assert measured["accuracy"] == pytest.approx(stored["accuracy"], abs=TOLERANCE)
