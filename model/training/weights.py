"""Paths of the model files, and whom each of them never saw. Does not import torch."""

from collections.abc import Sequence
from pathlib import Path

from touchd.drivers.recording import Recording
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.training import haart

HAART_MODEL = SHIPPED_MODEL.parent / "haart" / SHIPPED_MODEL.name
"""touchd-1, trained on HAART's training participants only, as the paper's network."""
WIDE_MODEL = HAART_MODEL.with_name("wide.onnx")
"""The same with wide augmentation, for the figure across studies."""
FABRIC_MODEL = SHIPPED_MODEL.with_name("fabric.onnx")
"""The shipped recipe without the third study, for the figure of a pad never met."""
LEFT_OUT_FOLDER = "left_out"
SEEDS_FOLDER = "seeds"
SCORES_NAME = "scores.json"


def fold_path(weights: Path, participants: Sequence[str]) -> Path:
    """Return the path of the network that never saw these participants."""
    return weights / LEFT_OUT_FOLDER / f"{'-'.join(participants)}.onnx"


def left_out_split(
    weights: Path, recordings: Sequence[Recording]
) -> list[tuple[Classifier, list[Recording]]]:
    """Return the networks that never saw some of these people, each with those people's recordings."""
    split = [
        (path, haart.only(recordings, path.stem.split("-")))
        for path in sorted((weights / LEFT_OUT_FOLDER).glob("*.onnx"))
    ]
    return [(Classifier.load(path), held_out) for path, held_out in split if held_out]


def touchd_1_files() -> list[Path]:
    """Return the files of touchd-1 and of its recipe's further seeds."""
    return [HAART_MODEL, *sorted((HAART_MODEL.parent / SEEDS_FOLDER).glob("*.onnx"))]
