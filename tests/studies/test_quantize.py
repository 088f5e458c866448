"""int8 copies of the shipped model: they answer alike, and are shipped only where figures say so."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="needs the extra `train`")

from docs.studies import quantize
from docs.studies.checks.hard_cases import hand
from docs.studies.checks.timing import Timing
from docs.studies.quantize import FLOAT32, Variant, decide
from docs.studies.training import haart
from drivers.recording import Recording, ideal_clock_ms
from model.classifier import SHIPPED_MODEL, Classifier, ModelError


def made_up(participant: str, gesture: str, strength: float) -> Recording:
    counts = np.rint(hand(432) * strength).astype(np.uint16)
    return Recording(participant, "foam", "fur", gesture, counts, ideal_clock_ms(432), "published")


def variant(name: str, processor_ms: float, accuracy: float) -> Variant:
    return Variant(name, 1_000_000, Timing(200, 9.0, 9.0, processor_ms), {54: 0.76, 144: accuracy})


@pytest.mark.parametrize("kind", ["int8 dynamic", "int8 static"])
def test_an_int8_copy_is_smaller_and_answers_alike(tmp_path: Path, kind: str) -> None:
    recordings = [made_up("P3", gesture, 0.2 * n) for n, gesture in enumerate(haart.GESTURES)]
    copy = quantize.convert(SHIPPED_MODEL, kind, recordings, tmp_path)
    assert copy.stat().st_size < 0.8 * SHIPPED_MODEL.stat().st_size
    plain, small = Classifier.load(SHIPPED_MODEL), Classifier.load(copy)
    assert small.metadata == plain.metadata
    windows = haart.cut(recordings, 72).counts
    differences = small.batch_probabilities(windows) - plain.batch_probabilities(windows)
    assert np.abs(differences).mean() < 0.05


def test_without_models_of_left_out_participants_nothing_is_measured() -> None:
    with pytest.raises(ModelError, match="no models of left-out participants there; `export` writes them"):
        quantize.run(SHIPPED_MODEL, [], [])


@pytest.mark.parametrize(
    ("int8", "ship"),
    [
        (variant("int8", 1.4, 0.80), "int8"),
        (variant("int8", 1.4, 0.79), FLOAT32),
        (variant("int8", 1.9, 0.80), FLOAT32),
    ],
)
def test_int8_ships_only_when_clearly_faster(int8: Variant, ship: str) -> None:
    assert decide([variant(FLOAT32, 2.0, 0.80), int8]).ship == ship


def test_the_decision_says_its_figures() -> None:
    decision = decide([variant(FLOAT32, 2.0, 0.80), variant("int8", 1.6, 0.79)])
    assert (
        decision.reason
        == "int8 takes 80% of the time and loses up to 1.0 points; allowed are 75% and 0.5 points"
    )
