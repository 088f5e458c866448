"""Speed against error: every network's time, size and memory for one answer, in one run on one thread.

The networks answer in turn, so that whatever else the machine does meets all alike.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median_low
from typing import Any

import torch

from docs.studies.quantize import FLOAT32
from docs.studies.report import front_page, front_picture, kept_int8, sizes
from docs.studies.report import networks as every
from docs.studies.report.macs import multiply_adds
from docs.studies.report.networks import INT8, OURS, SHIPPED, Network
from docs.studies.report.peak import idle_bytes, open_session, peak_bytes
from docs.studies.report.results import Results
from docs.studies.report.study import Study
from drivers.recording import Recording
from model.checks import evaluate
from model.checks.hard_cases import hand
from model.checks.timing import Timing, time_in_turn
from model.classifier import Classifier
from model.settings import LENGTHS
from model.training import haart
from model.training.threads import one_torch_thread

ONNX_RUNTIME = "onnx_runtime"
PYTORCH = "pytorch_eager"
ANSWERS = 200
PEAKS = 3


@dataclass(frozen=True)
class Asked:
    """One network asked over windows of one length in one runtime."""

    network: Network
    frames: int
    runtime: str
    answer: Callable[[], object]


def run(study: Study) -> None:
    """Measure every network in one run, unless all have been; sizes that are missing are trained first."""
    kept_int8.run(study)
    if all(study.results.has(key) for key in keys()):
        return
    files = sizes.ready(study.haart, study.checkpoints, study.threads)
    training = haart.realigned(haart.read_training(study.haart))
    began_s = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, one_torch_thread():
        networks = every.ours(files, training, Path(folder))
        for settings in every.paper_settings():
            networks += every.papers(settings, Path(folder))
        for system in every.CHALLENGE:
            for frames in LENGTHS:
                networks += every.hughes(system, frames, Path(folder))
        measured = measure(networks, haart.read_test(study.haart), ANSWERS)
    seconds = (time.perf_counter() - began_s) / len(measured)
    for key, values in measured.items():
        study.results.put(key, values, seconds)


def keys() -> list[str]:
    """Return where the results of all networks stand."""
    names = [SHIPPED, *sizes.SHAPES, *map(every.paper_name, every.paper_settings())]
    names += [every.hughes_name(system, frames) for system in every.CHALLENGE for frames in LENGTHS]
    return [f"front/{name}/{arithmetic}" for name in names for arithmetic in (FLOAT32, INT8)]


def measure(
    networks: Sequence[Network], test: Sequence[Recording], answers: int
) -> dict[str, dict[str, Any]]:
    """Return each network's figures by its key; ours are scored on the published test recordings.

    Times are of one answer, bytes of the file and of a process that does nothing but answer.
    """
    asked = [each for network in networks for each in _askings(network)]
    timings = time_in_turn([each.answer for each in asked], answers)
    idle = idle_bytes()
    # An int8 file does the same products, under other operators.
    counts = {
        (network.name, frames): multiply_adds(network.path, frames)
        for network in networks
        if network.arithmetic == FLOAT32
        for frames in network.frames
    }
    measured: dict[str, dict[str, Any]] = {}
    for network in networks:
        measured[network.key] = {
            "family": network.family,
            "width": network.width,
            "blocks": network.blocks,
            "answers_timed": answers,
            "file_bytes": network.path.stat().st_size,
            "peak_bytes": _settled_peak_bytes(network),
            "idle_bytes": idle,
            "at": {str(frames): {"multiply_adds": counts[network.name, frames]} for frames in network.frames},
        }
        if network.family == OURS:
            for frames, accuracy in accuracies(network.path, test).items():
                measured[network.key]["at"][frames]["accuracy"] = round(accuracy, 5)
    for each, timing in zip(asked, timings, strict=True):
        measured[each.network.key]["at"][str(each.frames)][each.runtime] = _times(timing)
    return measured


def accuracies(path: Path, test: Sequence[Recording]) -> dict[str, float]:
    """Return the macro accuracy of one of our files at each answered length, by the number of frames."""
    return evaluate.accuracies([(Classifier.load(path), test)], LENGTHS)


def section(results: Results) -> str:
    """Return the part of the page on speed against error, in Markdown."""
    return front_page.page(results)


def draw(results: Results, figures: Path) -> None:
    """Draw the front."""
    front_picture.draw(results, figures / "front.png")


def _askings(network: Network) -> list[Asked]:
    if network.family == OURS:
        classifier = Classifier.load(network.path)
        return [
            Asked(network, frames, ONNX_RUNTIME, _bind(classifier.probabilities, hand(frames)))
            for frames in network.frames
        ]
    (frames,) = network.frames
    window = hand(frames)[None]
    session = open_session(network.path)
    asked = [Asked(network, frames, ONNX_RUNTIME, lambda: session.run(None, {"counts": window}))]
    if network.eager is not None:
        asked.append(Asked(network, frames, PYTORCH, _eager(network.eager, torch.from_numpy(window))))
    return asked


def _bind(answer: Callable[[Any], object], window: object) -> Callable[[], object]:
    return lambda: answer(window)


def _eager(network: torch.nn.Module, window: torch.Tensor) -> Callable[[], object]:
    def answer() -> object:
        with torch.inference_mode():
            return network(window)

    return answer


def _settled_peak_bytes(network: Network) -> int:
    # Now and then a busy kernel lets a process hold pages that it has given back already.
    return median_low(peak_bytes(network.path, max(network.frames)) for _ in range(PEAKS))


def _times(timing: Timing) -> dict[str, float]:
    return {
        "p50_ms": round(timing.p50_ms, 4),
        "p99_ms": round(timing.p99_ms, 4),
        "processor_ms": round(timing.processor_ms, 4),
    }
