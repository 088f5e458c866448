"""The challenge's systems: features, training, and stored figures."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.haart_folder import HAART, haart_test_without_counts, needs_haart

pytest.importorskip("torch", reason="needs the extra `train`")
pytest.importorskip("sklearn", reason="needs the extra `studies`")

from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.adapt.head import one_torch_thread
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
FEATURES = {ta.features: 273, balli.features: 81, gaus.features: 724}


@pytest.mark.parametrize("frames", [54, 432])
@pytest.mark.parametrize("level", [0, 1023])
@pytest.mark.parametrize("make", FEATURES, ids=lambda make: make.__module__.rpartition(".")[2])
def test_a_pad_on_which_nothing_moves_has_all_its_features(make: Any, level: int, frames: int) -> None:
    made_features = make(np.full((2, frames, 8, 8), level, dtype=np.uint16))
    assert made_features.shape == (2, FEATURES[make])
    assert np.isfinite(made_features).all()


def made(participants: Sequence[str]) -> list[Recording]:
    """Return made-up recordings of a still pad, a tapped one and a busy one."""
    rng = np.random.default_rng(len(participants))
    recordings = []
    for participant in participants:
        tapped = np.where(np.arange(432) % 18 < 6, 200, 5)[:, np.newaxis, np.newaxis]
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


QUICK = ("ta-forest", "ta-svm", "gaus-boosting")
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
    [pytest.param(each, marks=[pytest.mark.slow] * (each.key not in QUICK)) for each in TRAINED],
    ids=lambda system: system.key,
)
def test_a_system_learns_reproducibly_and_chooses_without_the_test_file(system: System) -> None:
    chosen = small(system).choose(MadeUp(with_test=False))
    assert 0.0 <= chosen["left_out_accuracy"] <= 1.0
    settings = {"epochs": 12} if isinstance(system, DeepSystem) else chosen["settings"]
    data = MadeUp()
    with one_torch_thread():
        named, again = (small(system).train(data, settings, 1)(54) for _ in range(2))
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
