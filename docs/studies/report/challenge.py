"""The paper's table 1: the challenge's systems as published, and made again from their descriptions.

Recordings as published, not realigned; training participants train, the test file tests. The challenge
reported plain accuracy over whole recordings; macro accuracy stands beside it, and shorter windows.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from docs.studies.report import challenge_page
from docs.studies.report.challenge_kinds import Data, Shipped, System
from docs.studies.report.challenge_page import LENGTHS, cell_key, chosen_key
from docs.studies.report.challenge_systems import SYSTEMS
from docs.studies.report.results import Results
from docs.studies.report.study import Study
from model.training import haart, metrics
from model.training.haart import GESTURES
from model.training.metrics import Labels


def run(study: Study) -> None:
    """Choose, train and score what the results lack."""
    data = Data(study.haart)
    # What needs no training is there at once, however soon a run is broken off.
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
        values = {**scores(named, labels), "windows": len(labels), "answers": written(named)}
        results.put(cell_key(system, frames, seed), values, time.perf_counter() - began)
        began = time.perf_counter()


def scores(named: Labels, labels: Labels) -> dict[str, float]:
    """Return the plain and the macro accuracy of the classes named (N,) for windows of these labels (N,)."""
    return {
        "accuracy": round(float((named == labels).mean()), 5),
        "macro_accuracy": round(metrics.macro_accuracy(named, labels, len(GESTURES)), 5),
    }


def written(named: Labels) -> str:
    """Return the classes named (N,) as one digit each, so that a cell holds what its scores are of."""
    return "".join(map(str, named.tolist()))


def read(answers: str) -> Labels:
    """Return the classes (N,) from their digits."""
    return np.array(list(answers), dtype=np.int64)


def section(results: Results) -> str:
    """Return the table, and what it is and is not, in Markdown."""
    return "\n".join(challenge_page.lines(results))


def draw(results: Results, figures: Path) -> None:
    """Draw published and own accuracy of every system."""
    challenge_page.draw(results, figures)
