"""The time of an answer by window length, and by the number of pads in one process on one thread."""

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import nnls

from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.model.classifier import Classifier
from touchd.model.settings import LENGTHS
from touchd.model.studies.checks.hard_cases import hand
from touchd.model.studies.checks.timing import time_in_turn
from touchd.model.studies.marked import table
from touchd.model.studies.report.macs import multiply_adds
from touchd.model.studies.report.networks import SHIPPED, VARIANTS, export
from touchd.model.studies.report.paper_tgc import PaperSettings, PaperTGC
from touchd.model.studies.report.peak import open_session, peak_bytes
from touchd.model.studies.report.results import Results, Study, timing_values
from touchd.model.training.haart import GESTURES
from touchd.model.training.ship import HAART_MODEL

WINDOWS = (9, 27, 54, 81, 108, 144, 216, 432)
PADS = (1, 2, 4, 8, 16, 32, 64)
PAD_FRAMES = 144
ANSWERS = 200
NETWORKS: Mapping[str, str] = {
    SHIPPED: "touchd",
    "tgc-public": "the paper's, as its code has it",
    "tgc-printed": "the paper's, as printed",
}
WAYS: Mapping[str, str] = {"single": "one after another", "batched": "in one batch"}
FRAME_MS = 1000.0 / FRAME_RATE_HZ
COLOURS = ("#1f5fa8", "#c4611a", "#7a3f98")


Timed = tuple[dict[str, Any], Callable[[], Sequence[np.ndarray]]]
"""Something to time: its cell's values besides the time, and what answers."""


@dataclass(frozen=True)
class Law:
    """cost = sum of coefficients[power] * n ** power; largest_miss: share of a fitted cost."""

    coefficients: tuple[float, ...]
    largest_miss: float

    def parts(self, n: float) -> list[float]:
        """Return each term's part of the cost of n."""
        return [coefficient * n**power for power, coefficient in enumerate(self.coefficients)]

    def at(self, n: float) -> float:
        """Return the cost of n."""
        return float(sum(self.parts(n)))


def run(study: Study) -> None:
    """Measure windows and pads, each in one run, unless the results have them."""
    parts: list[tuple[list[str], Callable[[Path], dict[str, Timed]]]]
    parts = [(window_keys(), windows), (pad_keys(), lambda _: pads())]
    for keys, make in parts:
        if not all(map(study.results.has, keys)):
            with tempfile.TemporaryDirectory() as folder:
                timed, began_s = make(Path(folder)), time.perf_counter()
                study.results.put_together(measure(timed, ANSWERS), began_s)


def window_keys() -> list[str]:
    """Return where the results of growing windows stand."""
    return [f"cost/window/{frames}/{name}" for frames in WINDOWS for name in NETWORKS]


def pad_keys() -> list[str]:
    """Return where the results of growing numbers of pads stand."""
    return [f"cost/pads/{pads}/{way}" for pads in PADS for way in WAYS]


def windows(folder: Path) -> dict[str, Timed]:
    """Return one answer of the shipped network and of the paper's over windows of each length, by their keys.

    The paper's have random weights and one network a length; their files are written into `folder`.
    """
    classifier = Classifier.load(HAART_MODEL)
    timed: dict[str, Timed] = {}
    for frames in WINDOWS:
        counts = hand(frames)[np.newaxis]
        work = {"multiply_adds": multiply_adds(HAART_MODEL, frames)}
        timed[f"cost/window/{frames}/{SHIPPED}"] = work, _answering(classifier, counts)
        for variant in VARIANTS:
            torch.manual_seed(0)
            path = folder / f"{variant}-{frames}.onnx"
            export(PaperTGC(PaperSettings(variant, frames), len(GESTURES)).eval(), frames, path)
            answer = partial(open_session(path).run, None, {"counts": counts})
            timed[f"cost/window/{frames}/tgc-{variant}"] = (
                {"multiply_adds": multiply_adds(path, frames)},
                answer,
            )
    return timed


def pads(numbers: Sequence[int] = PADS) -> dict[str, Timed]:
    """Return the answers of pads whose windows are due at one moment: in one batch, and one after another."""
    classifier = Classifier.load(HAART_MODEL)
    window = hand(PAD_FRAMES)[np.newaxis]
    alone = {"peak_bytes": peak_bytes(HAART_MODEL, PAD_FRAMES)}
    timed: dict[str, Timed] = {}
    for number in numbers:
        together = {"peak_bytes": peak_bytes(HAART_MODEL, PAD_FRAMES, number)}
        batch = np.repeat(window, number, axis=0)
        timed[f"cost/pads/{number}/batched"] = together, _answering(classifier, batch)
        timed[f"cost/pads/{number}/single"] = alone, _answering(classifier, window, number)
    return timed


def measure(timed: Mapping[str, Timed], answers: int) -> dict[str, dict[str, Any]]:
    """Time all in turn; return the values of each cell by its key."""
    timings = time_in_turn([answer for _, answer in timed.values()], answers)
    return {
        key: {**values, "answers_timed": answers, **timing_values(timing)}
        for (key, (values, _)), timing in zip(timed.items(), timings, strict=True)
    }


def fit(costs: Mapping[int, float], degree: int) -> Law:
    """Return the law of that degree with the least squared misses, each as a share of its cost.

    As shares, because costs of small and large sizes lie far apart. No term can be negative.
    """
    n, cost = np.array(list(costs), dtype=float), np.array(list(costs.values()))
    powers = np.stack([n**power for power in range(degree + 1)], axis=1)
    coefficients, _ = nnls(powers / cost[:, None], np.ones(len(cost)))
    misses = np.abs(powers @ coefficients / cost - 1.0)
    return Law(tuple(coefficients.tolist()), float(misses.max()))


def costs(results: Results, of: str, name: str, figure: str = "processor_ms") -> dict[int, float]:
    """Return a figure by size: of "window" and a network's name, or of "pads" and a way of answering."""
    keys = [key for key in results.keys(f"cost/{of}/") if key.endswith(f"/{name}")]
    return dict(sorted((int(key.split("/")[2]), results.get(key)[figure]) for key in keys))


def tables(results: Results) -> dict[str, str]:
    """Return the tables of this part: figures and fitted laws, for growing windows and numbers of pads."""
    figures, laws = [], []
    for network, title in NETWORKS.items():
        p50, p99 = (costs(results, "window", network, figure) for figure in ("p50_ms", "p99_ms"))
        figures.append((title, *(f"{p50[frames]:.2f} / {p99[frames]:.2f}" for frames in p50)))
        law, work = (
            fit(costs(results, "window", network, figure), degree=2)
            for figure in ("processor_ms", "multiply_adds")
        )
        a, b, c = law.coefficients
        splits = (
            " / ".join(f"{100 * part / each.at(LENGTHS[-1]):.0f}" for part in each.parts(LENGTHS[-1]))
            for each in (law, work)
        )
        numbers = (f"{a:.3f}", f"{1e3 * b:.2f}", f"{1e6 * c:.1f}", f"{law.largest_miss:.0%}")
        laws.append((title, *numbers, *splits, f"{b / c:,.0f} frames" if c > 0 else "never"))
    pad_figures, pad_laws = [], []
    for pads in costs(results, "pads", "single"):
        single, batched = (results.get(f"cost/pads/{pads}/{way}") for way in WAYS)
        times = (f"{way['p50_ms']:.2f} / {way['p99_ms']:.2f}" for way in (single, batched))
        memory = f"{single['peak_bytes'] / 1e6:.0f} / {batched['peak_bytes'] / 1e6:.0f}"
        share = f"{batched['processor_ms'] / single['processor_ms']:.0%}"
        pad_figures.append((pads, *times, share, memory))
    for way, title in WAYS.items():
        law = fit(costs(results, "pads", way), degree=1)
        a, b = law.coefficients
        within = int((FRAME_MS - a) / b)
        pad_laws.append((title, f"{a:.3f}", f"{b:.3f}", f"{law.largest_miss:.0%}", within))
    law_headings = (
        "network",
        "a, ms",
        "b, µs a frame",
        "c, ns a frame²",
        "largest miss",
        "of the time: a / b L / c L², %",
        "of the multiply-adds, %",
        "c L² overtakes b L at",
    )
    pad_headings = ("pads", *WAYS.values(), "batch against single", "memory single / batch, MB")
    pad_law_headings = ("way", "a, ms", "b, ms a pad", "largest miss", f"pads within {FRAME_MS:.1f} ms")
    return {
        "cost-windows": table(("network", *(f"{frames} frames" for frames in WINDOWS)), figures),
        "cost-window-laws": table(law_headings, laws),
        "cost-pads": table(pad_headings, pad_figures),
        "cost-pad-laws": table(pad_law_headings, pad_laws),
    }


def draw(results: Results, figures: Path) -> None:
    """Draw the times and the laws fitted to them."""
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for colour, (network, title) in zip(COLOURS, NETWORKS.items(), strict=True):
        times = costs(results, "window", network)
        _curve(left, times, fit(times, degree=2).at, colour, title)
    left.set(title="one answer, as its window grows", xlabel="frames in the window", yscale="log")
    left.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    _ticks(left, WINDOWS)
    left.set_ylabel("processor time, ms")
    for colour, (way, title) in zip(COLOURS, WAYS.items(), strict=False):
        times = costs(results, "pads", way)
        law = fit(times, degree=1)
        each = {pads: time / pads for pads, time in times.items()}
        _curve(right, each, lambda pads, law=law: law.at(pads) / pads, colour, title)  # type: ignore[misc]
    right.set(title="touchd over 144 frames, as pads are added", xlabel="pads due at one moment")
    right.set_ylabel("processor time a pad, ms")
    right.margins(y=0.2)
    right.set_ylim(bottom=0)
    _ticks(right, PADS)
    figure.savefig(figures / "cost.png", dpi=120)


def _answering(classifier: Classifier, windows: np.ndarray, times: int = 1) -> Callable[[], list[np.ndarray]]:
    return lambda: [classifier.batch_probabilities(windows) for _ in range(times)]


def _curve(
    axes: Axes, times: Mapping[int, float], law: Callable[[float], float], colour: str, title: str
) -> None:
    sizes = np.geomspace(min(times), max(times), 100)
    axes.plot(sizes, [law(size) for size in sizes], color=colour, linewidth=1.2)
    axes.plot(list(times), list(times.values()), "o", color=colour, label=title)


def _ticks(axes: Axes, sizes: Sequence[int]) -> None:
    axes.set(xscale="log")
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.minorticks_off()
    axes.grid(True, linewidth=0.3, color="0.85")
    axes.legend(frameon=False, title="measured, and the law fitted to it", loc="best")
