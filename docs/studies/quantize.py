"""int8 copies of a model file, by ONNX Runtime's quantization: accuracy, time and whether to ship one.

Dynamic: the linear layers alone, with scales computed for each answer (dynamic convolutions are far slower
than float32 ones). Static: linear layers and convolutions, scales from training windows. The loss is measured
on participants left out: each fold's file is quantized by itself, on windows of its training people. Needs
the extra `train`.
"""

import argparse
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
from onnxruntime.quantization import (
    CalibrationDataReader,
    QuantFormat,
    QuantType,
    quantize_dynamic,
    quantize_static,
)
from rich.console import Console
from rich.table import Table

from docs.studies.checks import evaluate
from docs.studies.checks.hard_cases import FRAMES, hand
from docs.studies.checks.timing import Timing, time_in_turn
from docs.studies.folders import add_haart_argument
from docs.studies.training import haart
from docs.studies.training.ship import LEFT_OUT_FOLDER
from drivers.recording import Recording
from model.classifier import SHIPPED_MODEL, Classifier, ModelError
from model.settings import LENGTHS

FLOAT32 = "float32"
Quantize = Callable[[Path, Path, Sequence[Recording]], None]
"""Writes a copy of the first file to the second, by windows of the recordings."""
CALIBRATION_WINDOWS = 128
ANSWERS = 200
# int8 is a second arithmetic to verify: worth it only for a clear gain in time at next to no loss.
LARGEST_SHARE_OF_TIME = 0.75
LARGEST_LOSS = 0.005


@dataclass(frozen=True)
class Variant:
    """One arithmetic: the shipped file's size and time for 144 frames, left-out macro accuracy by length."""

    name: str
    file_bytes: int
    timing: Timing
    accuracy: dict[int, float]


@dataclass(frozen=True)
class Verdict:
    """Whether an int8 variant should ship in place of float32, and why."""

    ship: str
    reason: str


def main(arguments: Sequence[str]) -> int:
    """Quantize in a temporary folder, score and time, show table and decision; returns 0."""
    parser = argparse.ArgumentParser(
        prog="python -m docs.studies quantize", description="Weighs int8 against float32."
    )
    add_haart_argument(parser)
    parser.add_argument(
        "--weights", type=Path, default=Path("model/weights"), help="folder of the model files"
    )
    options = parser.parse_args(arguments)
    folds = sorted((options.weights / LEFT_OUT_FOLDER).glob("*.onnx"))
    variants = run(options.weights / SHIPPED_MODEL.name, folds, haart.read_training(options.haart))
    Console().print(table(variants))
    return 0


def run(model: Path, folds: Sequence[Path], training: Sequence[Recording]) -> list[Variant]:
    """Compare float32 and both kinds of int8.

    folds: model files with the participants that they left out in their metadata; training: published
    recordings.
    Raises ModelError.
    """
    if not folds:
        raise ModelError(f"{model.parent}: no models of left-out participants there; `export` writes them")
    live = haart.realigned(training)
    with tempfile.TemporaryDirectory() as folder:
        files = {name: convert(model, name, live, Path(folder)) for name in VARIANTS}
        window = hand(FRAMES)
        classifiers = [Classifier.load(path) for path in files.values()]
        timings = time_in_turn([_asker(classifier, window) for classifier in classifiers], ANSWERS)
        accuracies = [_left_out_accuracy(name, folds, live, Path(folder)) for name in VARIANTS]
        sizes = [path.stat().st_size for path in files.values()]
    return [Variant(*row) for row in zip(VARIANTS, sizes, timings, accuracies, strict=True)]


def decide(variants: Sequence[Variant]) -> Verdict:
    """Say whether to ship int8: where it takes clearly less time and loses next to nothing at any length."""
    plain, *others = variants
    reasons = []
    for other in others:
        share = other.timing.processor_ms / plain.timing.processor_ms
        loss = max(0.0, *(plain.accuracy[n] - other.accuracy[n] for n in plain.accuracy))
        reason = f"{other.name} takes {share:.0%} of the time and loses up to {100 * loss:.1f} points"
        if share <= LARGEST_SHARE_OF_TIME and loss <= LARGEST_LOSS:
            return Verdict(other.name, reason)
        reasons.append(reason)
    allowed = f"allowed are {LARGEST_SHARE_OF_TIME:.0%} and {100 * LARGEST_LOSS:.1f} points"
    return Verdict(plain.name, f"{'; '.join(reasons)}; {allowed}")


def table(variants: Sequence[Variant]) -> Table:
    """Return the comparison as a table for the terminal, the decision below it."""
    decision = decide(variants)
    shown = Table(title="int8 against float32", caption=f"Ship {decision.ship}: {decision.reason}.")
    shown.add_column("arithmetic")
    for heading in ("file MB", "p50 ms", "p99 ms", "processor ms", *(f"at {n} frames" for n in LENGTHS)):
        shown.add_column(heading, justify="right")
    for variant in variants:
        timing = variant.timing
        shown.add_row(
            variant.name,
            f"{variant.file_bytes / 1e6:.2f}",
            *(f"{ms:.2f}" for ms in (timing.p50_ms, timing.p99_ms, timing.processor_ms)),
            *(f"{variant.accuracy[length]:.1%}" for length in LENGTHS),
        )
    return shown


def dynamic(model: Path, target: Path, calibration: Sequence[Recording]) -> None:
    """Write an int8 copy whose scales are computed for each answer; the recordings are not needed."""
    quantize_dynamic(
        model, target, weight_type=QuantType.QInt8, per_channel=True, op_types_to_quantize=["MatMul", "Gemm"]
    )


def static(model: Path, target: Path, calibration: Sequence[Recording]) -> None:
    """Write an int8 copy whose scales come from windows of the recordings."""
    quantize_static(
        model,
        target,
        _Windows(calibration),
        quant_format=QuantFormat.QDQ,
        weight_type=QuantType.QInt8,
        activation_type=QuantType.QUInt8,
        per_channel=True,
        op_types_to_quantize=["Conv", "MatMul", "Gemm"],
    )


VARIANTS: dict[str, Quantize | None] = {FLOAT32: None, "int8 dynamic": dynamic, "int8 static": static}


def convert(model: Path, name: str, calibration: Sequence[Recording], folder: Path) -> Path:
    """Return the model file in the arithmetic asked for; float32 is the file itself."""
    quantize = VARIANTS[name]
    if quantize is None:
        return model
    # The exporter's notes on shapes no longer hold once the quantizer turns a Gemm's weight around.
    proto = onnx.load(model)
    del proto.graph.value_info[:]
    plain = folder / "plain.onnx"
    onnx.save(proto, plain)
    target = folder / f"{model.stem} {name}.onnx"
    quantize(plain, target, calibration)
    return target


class _Windows(CalibrationDataReader):  # type: ignore[misc]
    """Random windows of the longest answered length, one at a time, as ONNX Runtime asks for them."""

    def __init__(self, recordings: Sequence[Recording]) -> None:
        counts = haart.cut(recordings, LENGTHS[-1]).counts
        chosen = np.random.default_rng(0).permutation(len(counts))[:CALIBRATION_WINDOWS]
        self.windows: Iterator[np.ndarray] = iter(counts[chosen].astype(np.float32))

    def get_next(self) -> dict[str, np.ndarray] | None:
        window = next(self.windows, None)
        return None if window is None else {"counts": window[np.newaxis]}


def _left_out_accuracy(
    name: str, folds: Sequence[Path], live: Sequence[Recording], folder: Path
) -> dict[int, float]:
    split = []
    for fold in folds:
        left_out = tuple(Classifier.load(fold).metadata.training["left_out"])
        path = convert(fold, name, haart.without(live, left_out), folder)
        split.append((Classifier.load(path), haart.only(live, left_out)))
    return {length: evaluate.score(split, length).accuracy for length in LENGTHS}


def _asker(classifier: Classifier, window: np.ndarray) -> Callable[[], object]:
    return lambda: classifier.probabilities(window)
