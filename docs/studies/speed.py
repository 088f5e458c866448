"""Size and speed of one answer, ours against the paper's TGC: `python -m docs.studies speed`.

Shares are of processor time, each network on one thread. The paper's networks have random weights: a product
takes as long with any. Needs the extra `train`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from rich.table import Table

from docs.studies.report.paper_tgc import PaperSettings, PaperTGC
from drivers.frame import COLUMNS, ROWS
from model.checks.hard_cases import hand
from model.checks.timing import Timing, time_in_turn
from model.classifier import SHIPPED_MODEL, Classifier
from model.settings import LENGTHS
from model.training.export import OPSET
from model.training.threads import one_torch_thread

ONNX_RUNTIME = "ONNX Runtime"
PYTORCH = "PyTorch eager"
PAPER = (PaperSettings("printed"), PaperSettings("public"))
ANSWERS = 200
# Of the paper's time for an answer, in each runtime.
ALLOWED_SHARE = {ONNX_RUNTIME: 1 / 10, PYTORCH: 1 / 25}


@dataclass(frozen=True)
class Contestant:
    """One way to answer over one window. file_bytes: of the ONNX file."""

    network: str
    runtime: str
    frames: int
    file_bytes: int
    answer: Callable[[], object]


@dataclass(frozen=True)
class Speed:
    """How long one answer of a contestant takes."""

    network: str
    runtime: str
    frames: int
    file_bytes: int
    timing: Timing


@dataclass(frozen=True)
class Share:
    """Our median processor time as a share of another network's, both over the same window."""

    of: str
    runtime: str
    share: float
    allowed: float
    met: bool


def run(
    model: Path = SHIPPED_MODEL, answers: int = ANSWERS, paper: Sequence[PaperSettings] = PAPER
) -> list[Speed]:
    """Time the model file at each answered length and the paper's networks; raises ModelError."""
    with tempfile.TemporaryDirectory() as folder, one_torch_thread():
        contestants = [
            *ours(model),
            *(each for settings in paper for each in papers(settings, Path(folder))),
        ]
        timings = time_in_turn([contestant.answer for contestant in contestants], answers)
    return [
        Speed(each.network, each.runtime, each.frames, each.file_bytes, timing)
        for each, timing in zip(contestants, timings, strict=True)
    ]


def shares(speeds: Sequence[Speed]) -> list[Share]:
    """Compare our time in ONNX Runtime with every other contestant's over the same window."""
    own = {speed.frames: speed.timing.processor_ms for speed in speeds if speed.network == speeds[0].network}
    found = []
    for speed in speeds:
        if speed.network != speeds[0].network:
            share = own[speed.frames] / speed.timing.processor_ms
            allowed = ALLOWED_SHARE[speed.runtime]
            found.append(Share(speed.network, speed.runtime, share, allowed, share <= allowed))
    return found


def ours(model: Path) -> list[Contestant]:
    """Return the model file at each answered length, as the daemon asks it."""
    classifier = Classifier.load(model)
    return [
        Contestant(
            classifier.name,
            ONNX_RUNTIME,
            frames,
            model.stat().st_size,
            _bind(classifier.probabilities, frames),
        )
        for frames in sorted(LENGTHS, reverse=True)
    ]


def papers(settings: PaperSettings, folder: Path) -> list[Contestant]:
    """Return a network of the paper's, exported into `folder`, in both runtimes."""
    network = PaperTGC(settings, classes=7).eval()
    path = folder / f"{settings.variant}.onnx"
    export_paper(network, path)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    counts = hand(settings.frames)[np.newaxis]
    tensor = torch.from_numpy(counts)

    def answer_eager() -> object:
        with torch.inference_mode():
            return network(tensor)

    name, size = f"the paper's TGC, {settings.variant}", path.stat().st_size
    return [
        Contestant(name, ONNX_RUNTIME, settings.frames, size, lambda: session.run(None, {"counts": counts})),
        Contestant(name, PYTORCH, settings.frames, size, answer_eager),
    ]


def export_paper(network: PaperTGC, path: Path) -> None:
    """Write a network of the paper's as one ONNX file: (B, frames, 8, 8) counts to logits."""
    example = torch.zeros(2, network.settings.frames, ROWS, COLUMNS)
    program = torch.onnx.export(
        network,
        (example,),
        dynamo=True,
        opset_version=OPSET,
        input_names=["counts"],
        output_names=["logits"],
        dynamic_shapes={"counts": {0: torch.export.Dim("batch")}},
        verbose=False,
    )
    assert program is not None
    onnx.save(program.model_proto, path)


def table(speeds: Sequence[Speed]) -> Table:
    """Return the times as a table for the terminal, with our share of each of the paper's."""
    shown = Table(title="One answer on one thread, asked in turn", caption="The paper's weights are random.")
    for heading in ("network", "runtime", "frames", "file MB", "p50 ms", "p99 ms", "processor ms"):
        shown.add_column(heading, justify="left" if heading in ("network", "runtime") else "right")
    shown.add_column("ours takes", justify="right")
    shown.add_column("allowed", justify="right")
    compared = {(share.of, share.runtime): share for share in shares(speeds)}
    for speed in speeds:
        share = compared.get((speed.network, speed.runtime))
        against = (f"1/{1 / share.share:.1f}", f"1/{1 / share.allowed:.0f}") if share else ("", "")
        shown.add_row(
            speed.network,
            speed.runtime,
            str(speed.frames),
            f"{speed.file_bytes / 1e6:.2f}",
            f"{speed.timing.p50_ms:.2f}",
            f"{speed.timing.p99_ms:.2f}",
            f"{speed.timing.processor_ms:.2f}",
            *against,
        )
    return shown


def _bind(answer: Callable[[np.ndarray], object], frames: int) -> Callable[[], object]:
    window = hand(frames)
    return lambda: answer(window)
