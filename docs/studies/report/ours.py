"""Our network in the paper's table 3: one file a seed, each asked at every length, in both framings."""

from __future__ import annotations

import time
from pathlib import Path

from docs.studies.report.results import Results
from docs.studies.report.study import Study
from model.checks import evaluate
from model.checks.evaluate import REPORTED_LENGTHS
from model.classifier import Classifier
from model.training import haart
from model.training.ship import HAART_MODEL, SEEDS_FOLDER

FRAMINGS = ("published", "realigned")


def model_files() -> list[Path]:
    """Return the shipped file, then those of the recipe's further seeds."""
    return [HAART_MODEL, *sorted((HAART_MODEL.parent / SEEDS_FOLDER).glob("*.onnx"))]


def run(study: Study) -> None:
    """Score every seed's file at the lengths that the results lack."""
    missing = [
        (framing, frames)
        for framing in FRAMINGS
        for frames in REPORTED_LENGTHS
        if not study.results.has(key(framing, frames))
    ]
    if not missing:
        return
    published = haart.read_test(study.haart)
    recordings = {"published": published, "realigned": haart.realigned(published)}
    classifiers = [Classifier.load(path, study.threads) for path in model_files()]
    for framing, frames in missing:
        began = time.perf_counter()
        scores = [evaluate.score([(each, recordings[framing])], frames) for each in classifiers]
        values = {
            "windows": scores[0].windows,
            "accuracies": [round(score.accuracy, 5) for score in scores],
            "confusions": [score.confusion for score in scores],
        }
        study.results.put(key(framing, frames), values, time.perf_counter() - began)


def accuracies(results: Results, framing: str, frames: int) -> list[float]:
    """Return each seed's macro accuracy, the shipped one's first; empty when it is not measured yet."""
    if not results.has(key(framing, frames)):
        return []
    measured: list[float] = results.get(key(framing, frames))["accuracies"]
    return measured


def key(framing: str, frames: int) -> str:
    """Return the cell's key among the results."""
    return f"ours/{framing}/frames{frames}"
