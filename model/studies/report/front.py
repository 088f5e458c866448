"""Speed against error: time, size and memory of one answer of every network, in one run on one thread.

The networks answer in turn, so that other load on the machine affects all alike. Networks other than ours are
timed with random weights. The error of the paper's networks comes from tables 2 and 3 where they were trained
for all epochs, otherwise from the paper, which chose its epoch on the test participants. The error of the
challenge's networks comes from table 1.
"""

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product, starmap
from pathlib import Path
from statistics import median_low
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from touchd.drivers.recording import Recording
from touchd.model.adapt.threads import one_torch_thread
from touchd.model.classifier import Classifier
from touchd.model.settings import LENGTHS
from touchd.model.studies.accuracy import PAPER_ACCURACY
from touchd.model.studies.checks import evaluate
from touchd.model.studies.checks.hard_cases import hand
from touchd.model.studies.checks.timing import time_in_turn
from touchd.model.studies.marked import table
from touchd.model.studies.report import networks as every
from touchd.model.studies.report import sizes, table1
from touchd.model.studies.report.macs import multiply_adds
from touchd.model.studies.report.networks import (
    CHALLENGE,
    FLOAT32,
    HUGHES,
    INT8,
    OURS,
    PAPER_BLOCKS,
    SHIPPED,
    TimedNetwork,
)
from touchd.model.studies.report.paper_cells import PAPER_EPOCHS, Variant, accuracies, trained
from touchd.model.studies.report.peak import idle_bytes, open_session, peak_bytes
from touchd.model.studies.report.results import Results, Study, timing_values
from touchd.model.studies.report.tables23 import TABLE2, TABLE2_FRAMES
from touchd.model.training import haart

ONNX_RUNTIME = "onnx_runtime"
PYTORCH = "pytorch_eager"
ANSWERS = 200
# A busy kernel sometimes lets a process hold pages that it has already given back: take the median.
PEAKS = 3
PANELS = {"1 s": (54,), "1.5 s": (72, 81), "2.67 s": (144,)}
"""Windows of about one time; the paper's "1.5 seconds" are 72 frames."""
PAPER = {"public": "as its code has it", "printed": "as printed"}
PRINTED = "printed in the paper"
COLOURS = {OURS: "#1f5fa8", "public": "#c4611a", "printed": "#7a3f98"}
COST = ("multiply-adds, M", "p50, ms", "p99, ms", "processor, ms", "PyTorch p50 / p99, ms")
WEIGHT = ("file, MB", "memory, MB", "error, %", "error from")


@dataclass(frozen=True)
class Row:
    """One network over windows of one length.

    cell: its stored figures; at: those at this length. error: macro error, 0 to 1, None where unknown.
    """

    name: str
    arithmetic: str
    frames: int
    cell: dict[str, Any]
    error: float | None
    source: str

    @property
    def family(self) -> str:
        """Whose network it is."""
        return str(self.cell["family"])

    @property
    def at(self) -> dict[str, Any]:
        """The figures at this length."""
        found: dict[str, Any] = self.cell["at"][str(self.frames)]
        return found

    @property
    def processor_ms(self) -> float:
        """Median processor time, by which networks are compared: other load hardly changes it."""
        return float(self.at[ONNX_RUNTIME]["processor_ms"])

    @property
    def is_touchd_1(self) -> bool:
        """Whether this is the file that ships."""
        return (self.name, self.arithmetic) == (SHIPPED, FLOAT32)

    @property
    def title(self) -> str:
        """What tables call the network."""
        width, blocks = self.cell["width"], self.cell["blocks"]
        if self.family == OURS:
            return f"**touchd-1, {width} wide**" if self.is_touchd_1 else f"touchd, {width} wide"
        if self.family == HUGHES:
            return f"Hughes et al., {CHALLENGE[_system(self.name)]}"
        return f"the paper's, {PAPER[self.family]}, {blocks} block{'s' if blocks > 1 else ''}"

    def figures(self) -> list[str]:
        """Return the columns COST and WEIGHT."""
        runtime, eager = self.at[ONNX_RUNTIME], self.at.get(PYTORCH)
        return [
            f"{self.at['multiply_adds'] / 1e6:.1f}",
            *(f"{runtime[figure]:.2f}" for figure in ("p50_ms", "p99_ms", "processor_ms")),
            f"{eager['p50_ms']:.2f} / {eager['p99_ms']:.2f}" if eager else "",
            f"{self.cell['file_bytes'] / 1e6:.2f}",
            f"{self.cell['peak_bytes'] / 1e6:.0f}",
            "" if self.error is None else f"{100 * self.error:.1f}",
            self.source,
        ]


def run(study: Study) -> None:
    """Measure every network in one run, unless all have been; missing sizes are trained first."""
    papers = every.paper_settings()
    challenge = list(product(CHALLENGE, LENGTHS))
    names = [SHIPPED, *sizes.SHAPES, *map(every.paper_name, papers), *starmap(every.hughes_name, challenge)]
    if all(study.results.has(f"front/{name}/{kind}") for name in names for kind in (FLOAT32, INT8)):
        return
    files = sizes.ready(study.haart, study.checkpoints, study.threads)
    training = haart.realigned(haart.read_training(study.haart))
    began_s = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, one_torch_thread():
        networks = every.ours(files, training, Path(folder))
        for settings in papers:
            networks += every.papers(settings, Path(folder))
        for system, frames in challenge:
            networks += every.hughes(system, frames, Path(folder))
        measured = measure(networks, haart.read_test(study.haart), ANSWERS)
    study.results.put_together(measured, began_s)


def measure(
    networks: Sequence[TimedNetwork], test: Sequence[Recording], answers: int
) -> dict[str, dict[str, Any]]:
    """Return each network's figures by its key; ours are scored on the published test recordings."""
    idle = idle_bytes()
    # An int8 file has the same products, under other operators.
    work = {
        (network.name, frames): multiply_adds(network.path, frames)
        for network in networks
        if network.arithmetic == FLOAT32
        for frames in network.frames
    }
    measured: dict[str, dict[str, Any]] = {}
    for network in networks:
        scores = our_accuracies(network.path, test) if network.family == OURS else {}
        longest = max(network.frames)
        measured[network.key] = {
            "family": network.family,
            "width": network.width,
            "blocks": network.blocks,
            "answers_timed": answers,
            "file_bytes": network.path.stat().st_size,
            "peak_bytes": median_low(peak_bytes(network.path, longest) for _ in range(PEAKS)),
            "idle_bytes": idle,
            "at": {
                str(frames): {"multiply_adds": work[network.name, frames]}
                | ({"accuracy": round(scores[str(frames)], 5)} if scores else {})
                for frames in network.frames
            },
        }
    asked = [(network.key, *each) for network in networks for each in answers_of(network)]
    timings = time_in_turn([answer for *_, answer in asked], answers)
    for (key, frames, runtime, _), timing in zip(asked, timings, strict=True):
        measured[key]["at"][str(frames)][runtime] = timing_values(timing)
    return measured


def our_accuracies(path: Path, test: Sequence[Recording]) -> dict[str, float]:
    """Return the macro accuracy of one of our files at each answered length, by the number of frames."""
    live, classifier = haart.realigned(test), Classifier.load(path)
    return {str(length): evaluate.score([(classifier, live)], length).accuracy for length in LENGTHS}


def rows(results: Results) -> list[Row]:
    """Return what has been measured, ours first, by width and blocks."""
    found = []
    for key in results.keys("front/"):
        _, name, arithmetic = key.split("/")
        cell = results.get(key)
        for frames in map(int, cell["at"]):
            error, source = _error(results, name, arithmetic, cell, frames)
            found.append(Row(name, arithmetic, frames, cell, error, source))
    order = {OURS: 0, HUGHES: 1, "public": 2, "printed": 3}
    return sorted(found, key=lambda r: (order[r.family], r.cell["width"], r.cell["blocks"], r.frames))


def front(candidates: Sequence[Row]) -> list[Row]:
    """Return the Pareto front of time and error, fastest first."""
    kept: list[Row] = []
    best = np.inf
    for row in sorted(candidates, key=lambda row: row.processor_ms):
        if row.error is not None and row.error < best:
            kept.append(row)
            best = row.error
    return kept


def printed_error(frames: int, blocks: int) -> float | None:
    """Return the error that the paper prints for a length at its 6 blocks, or for blocks at 144 frames."""
    if blocks == PAPER_BLOCKS and frames in PAPER_ACCURACY:
        return 1.0 - PAPER_ACCURACY[frames] / 100
    return 1.0 - float(TABLE2[blocks].split()[0]) / 100 if frames == TABLE2_FRAMES else None


def trained_accuracies(results: Results, variant: Variant, frames: int, blocks: int) -> list[float]:
    """Return the last epoch's accuracy of networks trained here for as long as the paper's."""
    cells = trained(results).get((variant, blocks, frames), [])
    return [accuracies(results, cell)[-1] for cell in cells if cell.epochs >= PAPER_EPOCHS]


def tables(results: Results) -> dict[str, str]:
    """Return a table for each time, and one of the paper's networks by blocks."""
    found = rows(results)
    made = {}
    for name, lengths in PANELS.items():
        together = [
            row
            for row in found
            if row.frames in lengths and (row.family not in PAPER or row.cell["blocks"] == PAPER_BLOCKS)
        ]
        best = front(together)
        made[f"front-{name.replace(' ', '')}"] = table(
            ("network", "arithmetic", "frames", *COST, *WEIGHT, "on the front"),
            [
                (row.title, row.arithmetic, row.frames, *row.figures(), "yes" if row in best else "")
                for row in together
            ],
        )
    small = {row.name: row for row in found if row.arithmetic == INT8 and row.frames == TABLE2_FRAMES}
    made["front-blocks"] = table(
        ("network", *COST, *WEIGHT, "int8 processor, ms"),
        [
            (row.title, *row.figures(), f"{small[row.name].processor_ms:.2f}")
            for row in found
            if row.family in PAPER and row.frames == TABLE2_FRAMES and row.arithmetic == FLOAT32
        ],
    )
    return made


def draw(results: Results, figures: Path) -> None:
    """Draw error against the time of one answer, a panel for each time."""
    found = rows(results)
    figure = Figure(figsize=(13, 5.4), layout="constrained")
    panels = figure.subplots(1, len(PANELS), sharex=True, sharey=True)
    for axes, (name, lengths) in zip(panels, PANELS.items(), strict=True):
        _panel(axes, [row for row in found if row.frames in lengths])
        axes.set(title=f"after {name}", xlabel="processor time of one answer, ms", xscale="log")
        axes.grid(True, which="both", linewidth=0.3, color="0.85")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panels[0].set_xlim(left=0.5 * min(row.processor_ms for row in found))
    panels[0].set_ylabel("macro error on the test participants, %")
    legends = [axes.get_legend_handles_labels() for axes in panels]
    handles = {label: handle for pair in legends for handle, label in zip(*pair, strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(figures / "front.png", dpi=120)


def _panel(axes: Axes, together: Sequence[Row]) -> None:
    best = front(together)
    style: dict[str, Any] = {"where": "post", "color": "0.6", "linewidth": 5, "alpha": 0.45}
    style["label"] = "the front: none is both faster and better"
    axes.step([row.processor_ms for row in best], [_percent(row) for row in best], **style)
    blue = COLOURS[OURS]
    for arithmetic, fill, line in ((FLOAT32, blue, "-"), (INT8, "white", ":")):
        ours = [row for row in together if (row.family, row.arithmetic) == (OURS, arithmetic)]
        _points(axes, ours, f"touchd {arithmetic}, by width", blue, marker="o", mfc=fill, linestyle=line)
    touchd_1 = [row for row in together if row.is_touchd_1]
    for row in together:
        if (row.family, row.arithmetic) == (OURS, FLOAT32):
            # The star of touchd-1 would hide a label to its left.
            is_wider = row.cell["width"] > touchd_1[0].cell["width"]
            style = {"xytext": (8, -4), "ha": "left"} if is_wider else {"xytext": (-20, -4), "ha": "right"}
            place = (row.processor_ms, _percent(row))
            axes.annotate(str(row.cell["width"]), place, textcoords="offset points", color=blue, **style)
    _points(axes, touchd_1, "touchd-1", "gold", marker="*", mec=blue, markersize=18, zorder=5)
    challenge = [row for row in together if row.family == HUGHES and row.error is not None]
    _points(axes, challenge, "the challenge's networks, Hughes et al.", "0.35", marker="D")
    for family, code in PAPER.items():
        theirs = [row for row in together if row.family == family and row.error is not None]
        made = [row for row in theirs if row.source != PRINTED]
        printed = [row for row in theirs if row.source == PRINTED]
        own = [row for row in printed if row.cell["blocks"] == PAPER_BLOCKS]
        others = [row for row in printed if row.cell["blocks"] != PAPER_BLOCKS]
        colour = COLOURS[family]
        _points(axes, others, f"its figures for other numbers of blocks, {code}", colour, marker=".")
        _points(axes, made, f"the paper's network {code}, trained here", colour, marker="s")
        _points(axes, own, f"the paper's figure, network {code}", colour, marker="X", markersize=11)


def _points(axes: Axes, shown: Sequence[Row], label: str, colour: str, **style: Any) -> None:
    if shown:
        times, errors = [row.processor_ms for row in shown], [_percent(row) for row in shown]
        axes.plot(times, errors, **{"linestyle": "", "markersize": 7, **style}, color=colour, label=label)


def _percent(row: Row) -> float:
    return 100 * (row.error or 0.0)


def _error(
    results: Results, name: str, arithmetic: str, cell: dict[str, Any], frames: int
) -> tuple[float | None, str]:
    """Return a network's error and where it is from."""
    figures, family, blocks = cell["at"][str(frames)], cell["family"], cell["blocks"]
    if "accuracy" in figures:
        return 1.0 - figures["accuracy"], "measured"
    if arithmetic != FLOAT32:
        return None, ""
    if family == HUGHES:
        measured = table1.scores_of(results, _system(name), frames, "macro_accuracy")
    else:
        measured = trained_accuracies(results, family, frames, blocks)
    if measured:
        seeds = "1 seed" if len(measured) == 1 else f"{len(measured)} seeds"
        return 1.0 - float(np.mean(measured)), f"trained here, {seeds}"
    printed = None if family == HUGHES else printed_error(frames, blocks)
    return printed, "" if printed is None else PRINTED


def _system(name: str) -> str:
    return name.rsplit("-", 2)[0]


def answers_of(network: TimedNetwork) -> list[tuple[int, str, Callable[[], object]]]:
    """Return the answers to time: frames, runtime, and what answers."""
    if network.family == OURS:
        classifier = Classifier.load(network.path)
        return [(n, ONNX_RUNTIME, partial(classifier.probabilities, hand(n))) for n in network.frames]
    (frames,) = network.frames
    window, session = hand(frames)[None], open_session(network.path)
    asked: list[tuple[int, str, Callable[[], object]]]
    asked = [(frames, ONNX_RUNTIME, partial(session.run, None, {"counts": window}))]
    if network.eager is not None:
        asked.append((frames, PYTORCH, partial(_ask_eagerly, network.eager, torch.from_numpy(window))))
    return asked


def _ask_eagerly(network: torch.nn.Module, window: torch.Tensor) -> object:
    with torch.inference_mode():
        return network(window)
