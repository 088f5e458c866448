"""int8 copies of the shipped model answer as it does."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="needs the extra `train`")

from docs.studies.checks.hard_cases import hand
from docs.studies.report import int8
from docs.studies.training import haart
from drivers.recording import Recording, ideal_clock_ms
from model.classifier import SHIPPED_MODEL, Classifier


def made_up(gesture: str, strength: float) -> Recording:
    counts = np.rint(hand(432) * strength).astype(np.uint16)
    return Recording("P3", "foam", "fur", gesture, counts, ideal_clock_ms(432), "published")


@pytest.mark.parametrize("kind", ["dynamic", "static"])
def test_an_int8_copy_is_smaller_and_answers_alike(tmp_path: Path, kind: str) -> None:
    recordings = [made_up(gesture, 0.2 * n) for n, gesture in enumerate(haart.GESTURES)]
    if kind == "dynamic":
        copy = int8.dynamic(SHIPPED_MODEL, tmp_path)
    else:
        copy = int8.static(SHIPPED_MODEL, recordings, tmp_path)
    assert copy.stat().st_size < 0.8 * SHIPPED_MODEL.stat().st_size
    plain, small = Classifier.load(SHIPPED_MODEL), Classifier.load(copy)
    assert small.metadata == plain.metadata
    windows = haart.cut(recordings, 72).counts
    differences = small.batch_probabilities(windows) - plain.batch_probabilities(windows)
    assert np.abs(differences).mean() < 0.05
