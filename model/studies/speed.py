"""Time and error of one answer, of our networks and others': `python -m touchd.model.studies speed`.

The networks are timed interleaved in one run, each on one thread, so that other load on the machine affects
them equally. Other people's networks have random weights here, which does not change the time.
"""

import logging
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np
import onnx
import onnxruntime
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from torch import Tensor, nn

from touchd.drivers.frame import COLUMNS, ROWS
from touchd.model.adapt.head import one_torch_thread
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.settings import LENGTHS
from touchd.model.studies.challenge.hughes import AUTOENCODER_RNN, CNN, CRNN, HughesNetwork
from touchd.model.studies.challenge.table import FILE as CHALLENGE_FILE
from touchd.model.studies.challenge.table import scores_of
from touchd.model.studies.checks.hard_cases import hand
from touchd.model.studies.checks.scores import read_scores
from touchd.model.studies.checks.timing import time_interleaved
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.studies.paper import FILE as PAPER_FILE
from touchd.model.studies.paper import our_key
from touchd.model.studies.paper_network import PaperSettings, PaperTGC
from touchd.model.studies.published import TABLE3
from touchd.model.studies.results import STORED, Results, keep, machine
from touchd.model.training.export import OPSET
from touchd.model.training.haart import GESTURES
from touchd.model.training.weights import HAART_MODEL, SCORES_NAME

FILE = STORED / "speed.json"
ANSWERS = 200
WINDOW, NEXT_FRAME = "window", "next frame"
"""Kinds of answers: a whole window, or its last frame from the state before it."""
PAPER_LENGTHS = (54, 72, 144)
PAPERS: Mapping[str, str] = MappingProxyType(
    {"printed": "the paper's, printed", "public": "the paper's, its code"}
)
CHALLENGE: Mapping[str, str] = MappingProxyType(
    {"hughes-cnn": CNN, "hughes-crnn": CRNN, "hughes-autoencoder": AUTOENCODER_RNN}
)
"""Networks of the challenge by their keys in table 1."""
TABLE_FRAMES = 144


class Speed(msgspec.Struct, frozen=True, kw_only=True):
    """How long one answer takes. error: macro error on the challenge's test participants, None if unknown."""

    network: str
    asked: str
    frames: int
    file_bytes: int
    processor_ms: float
    """Median processor time, which other load hardly changes."""
    error: float | None


class Measured(msgspec.Struct, frozen=True):
    """One run, the shipped network first."""

    machine: str
    speeds: tuple[Speed, ...]

    @property
    def shipped(self) -> Speed:
        """The shipped network's answer to the table's window."""
        return next(each for each in self.speeds if each.frames == TABLE_FRAMES)


@dataclass(frozen=True)
class Asked:
    """One answer to time."""

    network: str
    asked: str
    frames: int
    file: Path
    error: float | None
    answer: Callable[[], object]


class HughesAnswer(nn.Module):
    """A network of the challenge as deployed: counts (B, L, 8, 8) to log probabilities (B, classes)."""

    def __init__(self, kind: str) -> None:
        super().__init__()
        self.network = HughesNetwork(kind, len(GESTURES))

    def forward(self, counts: Tensor) -> Tensor:
        """Return (B, classes) log probabilities."""
        return self.network.answer(counts)


def main(arguments: Sequence[str]) -> int:
    """Time the answers and print the table; with --write also fill the page. Returns 0."""
    parser = study_parser("speed", "Times one answer of every network, in a minute or two.", "docs")
    parser.add_argument("--model", type=Path, default=SHIPPED_MODEL, help="an ONNX file of touchd's")
    parser.add_argument("--answers", type=int, default=ANSWERS, help="answers timed of each (%(default)s)")
    parser.add_argument("--write", action="store_true", help="store the times, fill docs/speed.md, draw")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder, one_torch_thread():
        measured = run(answers_of(options.model, Path(folder)), options.answers)
    if options.write:
        keep(FILE, measured)
        fill(options.docs / "speed.md", tables(measured))
        draw(measured, options.docs / "figures" / "front.png")
    shown = Table(box=SIMPLE_HEAD)
    for heading in HEADINGS:
        shown.add_column(heading, justify="left" if heading == HEADINGS[0] else "right")
    for row in rows(measured):
        shown.add_row(*row)
    Console().print(shown)
    return 0


def run(asked: Sequence[Asked], answers: int) -> Measured:
    """Time the answers, interleaved."""
    times_ms = time_interleaved([each.answer for each in asked], answers)
    return Measured(
        machine(),
        tuple(
            Speed(
                network=each.network,
                asked=each.asked,
                frames=each.frames,
                file_bytes=each.file.stat().st_size,
                processor_ms=round(processor_ms, 4),
                error=None if each.error is None else round(each.error, 4),
            )
            for each, processor_ms in zip(asked, times_ms, strict=True)
        ),
    )


def answers_of(model: Path, folder: Path) -> list[Asked]:
    """Return the answers of every network; `folder` takes the exported files of others'."""
    asked = [*ours(model, _shipped_error), *ours(HAART_MODEL, _touchd_1_error)]
    for variant, title in PAPERS.items():
        for frames in PAPER_LENGTHS:
            settings = PaperSettings("printed" if variant == "printed" else "public", frames)
            asked.append(paper(title, settings, folder, 1.0 - TABLE3[frames] / 100))
    results = Results(CHALLENGE_FILE)
    for key, kind in CHALLENGE.items():
        for frames in LENGTHS:
            error = 1.0 - float(np.mean(scores_of(results, key, frames, "macro_accuracy")))
            torch.manual_seed(0)
            path = folder / f"{key}-{frames}.onnx"
            export(HughesAnswer(kind).eval(), frames, path)
            title = f"Hughes, {kind}"
            asked.append(Asked(title, WINDOW, frames, path, error, _session(path, frames)))
    return asked


def ours(model: Path, error: Callable[[int], float | None]) -> list[Asked]:
    """Return a file's answers to windows, the longest first, and to the last frame of the longest."""
    classifier = Classifier.load(model)
    asked = [
        Asked(classifier.name, WINDOW, n, model, error(n), partial(classifier.probabilities, hand(n)))
        for n in sorted(LENGTHS, reverse=True)
    ]
    if classifier.states:
        counts = hand(TABLE_FRAMES)
        _, state = classifier.step(counts[:-1])
        step = partial(classifier.step, counts[-1:], state)
        asked.insert(1, Asked(classifier.name, NEXT_FRAME, TABLE_FRAMES, model, error(TABLE_FRAMES), step))
    return asked


def paper(title: str, settings: PaperSettings, folder: Path, error: float | None) -> Asked:
    """Return the answer of one of the paper's networks in ONNX Runtime."""
    torch.manual_seed(0)
    network, frames = PaperTGC(settings, len(GESTURES)).eval(), settings.frames
    path = folder / f"{settings.variant}-{frames}.onnx"
    export(network, frames, path)
    return Asked(title, WINDOW, frames, path, error, _session(path, frames))


def export(network: nn.Module, frames: int, path: Path) -> None:
    """Write a network that answers at one length as an ONNX file: (1, frames, 8, 8) counts to answers."""
    # Hide needless warnings: torchvision is missing but not used, and LSTM weights are exported all the same.
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network,
            (torch.zeros(1, frames, ROWS, COLUMNS),),
            dynamo=True,
            opset_version=OPSET,
            input_names=["counts"],
            output_names=["answers"],
            verbose=False,
        )
    assert program is not None
    onnx.save(program.model_proto, path)


HEADINGS = ("one answer", "file, MB", "ms", "times ours", "error, %")


def rows(measured: Measured) -> list[tuple[str, ...]]:
    """Return the rows under HEADINGS: all networks' answers to 144 frames."""
    shipped = measured.shipped
    return [
        (
            each.network if each.asked == WINDOW else f"{each.network}, {each.asked}",
            f"{each.file_bytes / 1e6:.1f}",
            f"{each.processor_ms:.2f}",
            f"{each.processor_ms / shipped.processor_ms:.2f}",
            "" if each.error is None else f"{100 * each.error:.1f}",
        )
        for each in measured.speeds
        if each.frames == TABLE_FRAMES
    ]


def tables(measured: Measured) -> dict[str, str]:
    """Return the page's table."""
    return {"speed": table(HEADINGS, rows(measured))}


def draw(measured: Measured, path: Path) -> None:
    """Draw error against processor time, a line per network from its shortest window to its longest."""
    figure = Figure(figsize=(7.6, 4.4), layout="constrained")
    axes = figure.subplots()
    windows = [each for each in measured.speeds if each.asked == WINDOW and each.error is not None]
    shipped = measured.shipped.network
    for network in dict.fromkeys(each.network for each in windows):
        own = sorted((each for each in windows if each.network == network), key=lambda each: each.frames)
        line = [(each.processor_ms, 100 * (each.error or 0.0)) for each in own]
        _draw_line(axes, network, line, is_shipped=network == shipped)
    axes.set(xscale="log", xlabel="processor time of one answer, ms", xlim=(0.02, 400))
    axes.set_ylabel("macro error on the test participants, %")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)


def _draw_line(axes: Axes, network: str, line: Sequence[tuple[float, float]], *, is_shipped: bool) -> None:
    """Draw a network's line, and its name above its first point or beside its last."""
    is_ours, is_papers = network.startswith("touchd"), network in PAPERS.values()
    colour = "#1f5fa8" if is_ours else "#c4611a" if is_papers else "0.45"
    axes.plot(*zip(*line, strict=True), "o-", color=colour, markersize=4)
    place, offset, align = line[-1], (8, -3), "left"
    if network in (PAPERS["printed"], f"Hughes, {CNN}") or (is_ours and not is_shipped):
        place, offset, align = line[0], (0, 6), "center"
    elif is_papers:
        offset, align = (0, -14), "right"
    style: dict[str, Any] = {"textcoords": "offset points", "fontsize": 8, "color": colour, "ha": align}
    axes.annotate(network, place, xytext=offset, **style)


def _shipped_error(frames: int) -> float | None:
    scores = read_scores(SHIPPED_MODEL.with_name(SCORES_NAME))
    return 1.0 - next(row.accuracy for row in scores.test.realigned if row.frames == frames)


def _touchd_1_error(frames: int) -> float:
    return 1.0 - float(np.mean(Results(PAPER_FILE).get(our_key("realigned", frames))["accuracies"]))


def _session(path: Path, frames: int) -> Callable[[], object]:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    return partial(session.run, None, {"counts": hand(frames)[None]})
