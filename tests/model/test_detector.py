"""The learned detector: its file answers as the network does, and finds hands on a made pad."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from rigs.made_pad import MadePad, Scans, nothing, palm

pytest.importorskip("torch", reason="needs the extra `train`")

import torch

from touchd.drivers.frame import NO_TOUCH
from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.classifier import SHIPPED_MODEL
from touchd.model.detector import Detector
from touchd.model.training.detector import signals
from touchd.model.training.detector.export import export
from touchd.model.training.detector.network import DetectorNetwork
from touchd.model.training.detector.pieces import PIECE_FRAMES, Composer, set_ups
from touchd.model.training.detector.train import DetectorRecipe, DetectorSettings, teacher


# An export takes seconds.
@pytest.mark.slow
def test_the_file_answers_as_the_network(tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = DetectorNetwork().eval()
    export(network, {"left_out": []}, tmp_path / "detector.onnx")
    detector = Detector.load(tmp_path / "detector.onnx")
    frames = MadePad().counts(np.concatenate([nothing(0.5), palm(0.5, 40.0)])).reshape(-1, 64)
    counts = frames.astype(np.float32)
    state = detector.begin(counts[:27])
    pad, hidden = signals.begin(torch.from_numpy(counts[:27])[None]), torch.zeros(1, detector.width)
    for row in counts[27:]:
        answer, state = detector.step(row, state, is_touch=False)
        with torch.no_grad():
            wanted, pad, hidden = network.step(
                torch.from_numpy(row)[None, None], pad, hidden, torch.zeros(1, 1)
            )
        assert answer == pytest.approx(float(wanted), abs=1e-5)


def test_the_recipe_is_that_of_the_shipped_detectors() -> None:
    for name, settings in DetectorRecipe.read().jobs().items():
        shipped = Detector.load(SHIPPED_MODEL.parent / name)
        assert msgspec.convert(shipped.training, DetectorSettings) == settings


def recording(gesture: str, scans: Scans) -> Recording:
    counts = MadePad().counts(scans)
    return Recording("P1", "foam", "none", gesture, counts, ideal_clock_ms(len(counts)), "live")


def test_a_piece_has_rest_touches_and_their_truth() -> None:
    made = set_ups([recording(NO_TOUCH, nothing(8.0)), recording("rub", palm(8.0, 60.0))])
    pieces = [Composer([made], [], seed).piece() for seed in range(20)]
    assert all(piece.counts.shape == (PIECE_FRAMES, 64) for piece in pieces)
    assert all(piece.counts.min() >= 0 and piece.counts.max() <= 1023 for piece in pieces)
    touched = [piece for piece in pieces if piece.targets.any()]
    assert len(touched) > 10
    # Rest is measured before the first hand comes.
    assert all(piece.targets[:30].max() == 0 for piece in pieces)


def test_the_same_seed_makes_the_same_pieces_and_lessons() -> None:
    made = set_ups([recording(NO_TOUCH, nothing(8.0)), recording("rub", palm(8.0, 60.0))])
    lessons = []
    for composer in (Composer([made], [], 3), Composer([made], [], 3)):
        pieces = [composer.piece() for _ in range(8)]
        asked = teacher(pieces, composer.rng)
        none = torch.zeros(0)
        told = [asked(t, none, signals.Pad(none, none, none)) for t in range(PIECE_FRAMES)]
        lessons.append((np.stack([piece.counts for piece in pieces]), torch.cat(told, dim=1).numpy()))
    for one, other in zip(*lessons, strict=True):
        np.testing.assert_array_equal(one, other)
