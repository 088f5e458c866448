"""What an answer costs as its window grows, and as more pads are answered by one process on one thread."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch

from docs.studies.report import cost_page, cost_picture
from docs.studies.report.cost_page import DAEMON_KEY
from docs.studies.report.macs import multiply_adds
from docs.studies.report.networks import SHIPPED, VARIANTS, export
from docs.studies.report.paper_tgc import PaperSettings, PaperTGC
from docs.studies.report.peak import open_session, peak_bytes
from docs.studies.report.results import Results
from docs.studies.report.study import Study
from model.checks.hard_cases import hand
from model.checks.timing import Timing, time_in_turn
from model.classifier import SHIPPED_MODEL, Classifier
from model.training.haart import GESTURES

WINDOWS = (9, 27, 54, 81, 108, 144, 216, 432)
PADS = (1, 2, 4, 8, 16, 32, 64)
PAD_FRAMES = 144
BATCHED, SINGLE = "batched", "single"
ANSWERS = 200
DAEMON_S = 45.0
DAEMON_LIMIT_S = 300.0


@dataclass(frozen=True)
class Asked:
    """Something to be timed. key: of its cell; values: what is known of it beside the time."""

    key: str
    values: dict[str, Any]
    answer: Callable[[], Sequence[np.ndarray]]


def run(study: Study) -> None:
    """Measure windows and pads, each in one run, unless that has been done."""
    if not all(study.results.has(key) for key in window_keys()):
        with tempfile.TemporaryDirectory() as folder:
            _keep(study.results, windows(Path(folder)), ANSWERS)
    if not all(study.results.has(key) for key in pad_keys()):
        _keep(study.results, pads(), ANSWERS)
    if not study.results.has(DAEMON_KEY):
        began_s = time.perf_counter()
        values = whole_daemon()
        study.results.put(DAEMON_KEY, values, time.perf_counter() - began_s)


def window_keys() -> list[str]:
    """Return where the results of growing windows stand."""
    names = [SHIPPED, *map(_paper_name, VARIANTS)]
    return [f"cost/window/{frames}/{name}" for frames in WINDOWS for name in names]


def pad_keys() -> list[str]:
    """Return where the results of growing numbers of pads stand."""
    return [f"cost/pads/{pads}/{way}" for pads in PADS for way in (BATCHED, SINGLE)]


def windows(folder: Path, lengths: Sequence[int] = WINDOWS) -> list[Asked]:
    """Return one answer of the shipped network, and of each of the paper's, over windows of each length.

    The paper's have random weights and one network a length; their files are written into `folder`.
    """
    classifier = Classifier.load(SHIPPED_MODEL)
    asked = []
    for frames in lengths:
        asked.append(
            Asked(
                f"cost/window/{frames}/{SHIPPED}",
                {"multiply_adds": multiply_adds(SHIPPED_MODEL, frames)},
                _asking(classifier, hand(frames)[np.newaxis]),
            )
        )
        asked += [_paper(PaperSettings(variant, frames), folder) for variant in VARIANTS]
    return asked


def pads(numbers: Sequence[int] = PADS) -> list[Asked]:
    """Return the answers of pads whose windows are due at one moment: in one batch, and one after another."""
    classifier = Classifier.load(SHIPPED_MODEL)
    window = hand(PAD_FRAMES)[np.newaxis]
    alone = peak_bytes(SHIPPED_MODEL, PAD_FRAMES)
    asked = []
    for number in numbers:
        together = {"peak_bytes": peak_bytes(SHIPPED_MODEL, PAD_FRAMES, number)}
        batch = np.repeat(window, number, axis=0)
        asked.append(Asked(f"cost/pads/{number}/{BATCHED}", together, _asking(classifier, batch)))
        one_by_one = _asking(classifier, window, times=number)
        asked.append(Asked(f"cost/pads/{number}/{SINGLE}", {"peak_bytes": alone}, one_by_one))
    return asked


def measure(asked: Sequence[Asked], answers: int) -> dict[str, dict[str, Any]]:
    """Time all in turn; return the values of each cell by its key."""
    timings = time_in_turn([each.answer for each in asked], answers)
    return {each.key: {**each.values, **_times(timing)} for each, timing in zip(asked, timings, strict=True)}


def whole_daemon() -> dict[str, Any]:
    """Return what `touchd bench` says of the daemon with one pad: reading, tracking and answering."""
    command = [sys.executable, "-m", "daemon", "bench", "--json", "--seconds", str(DAEMON_S)]
    done = subprocess.run(command, capture_output=True, check=True, timeout=DAEMON_LIMIT_S)
    return msgspec.json.decode(done.stdout, type=dict[str, Any])


def section(results: Results) -> str:
    """Return the part of the page on cost, in Markdown."""
    return cost_page.page(results)


def draw(results: Results, figures: Path) -> None:
    """Draw the times and the laws fitted to them."""
    cost_picture.draw(results, figures / "cost.png")


def _keep(results: Results, asked: Sequence[Asked], answers: int) -> None:
    began_s = time.perf_counter()
    measured = measure(asked, answers)
    seconds = (time.perf_counter() - began_s) / len(measured)
    for key, values in measured.items():
        results.put(key, values, seconds)


def _paper(settings: PaperSettings, folder: Path) -> Asked:
    torch.manual_seed(0)
    path = folder / f"{settings.variant}-{settings.frames}.onnx"
    export(PaperTGC(settings, len(GESTURES)).eval(), settings.frames, path)
    session, counts = open_session(path), hand(settings.frames)[np.newaxis]
    return Asked(
        f"cost/window/{settings.frames}/{_paper_name(settings.variant)}",
        {"multiply_adds": multiply_adds(path, settings.frames)},
        lambda: session.run(None, {"counts": counts}),
    )


def _paper_name(variant: str) -> str:
    return f"tgc-{variant}"


def _asking(classifier: Classifier, windows: np.ndarray, times: int = 1) -> Callable[[], list[np.ndarray]]:
    def answer() -> list[np.ndarray]:
        return [classifier.batch_probabilities(windows) for _ in range(times)]

    return answer


def _times(timing: Timing) -> dict[str, float]:
    return {
        "answers_timed": timing.answers,
        "p50_ms": round(timing.p50_ms, 4),
        "p99_ms": round(timing.p99_ms, 4),
        "processor_ms": round(timing.processor_ms, 4),
    }
