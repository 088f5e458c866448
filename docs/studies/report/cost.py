"""The time of an answer by window length, and by the number of pads in one process on one thread."""

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.axes import Axes
from scipy.optimize import nnls

from docs.studies.checks.hard_cases import hand
from docs.studies.checks.timing import time_in_turn
from docs.studies.marked import table
from docs.studies.report.macs import multiply_adds
from docs.studies.report.networks import SHIPPED, VARIANTS, export
from docs.studies.report.paper_tgc import PaperSettings, PaperTGC
from docs.studies.report.peak import open_session, peak_bytes
from docs.studies.report.results import Results, Study, timing_values
from docs.studies.training.haart import GESTURES
from docs.studies.training.ship import HAART_MODEL
from drivers.frame import FRAME_RATE_HZ
from model.classifier import Classifier
from model.settings import LENGTHS

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


@dataclass(frozen=True)
class Timed:
    """Something to time. values: its cell's values besides the time."""

    key: str
    values: dict[str, Any]
    answer: Callable[[], Sequence[np.ndarray]]


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

    def shares(self, n: float) -> list[float]:
        """Return each term's share of the cost of n."""
        return [part / self.at(n) for part in self.parts(n)]


def run(study: Study) -> None:
    """Measure windows and pads, each in one run, unless the results have them."""
    if not all(study.results.has(key) for key in window_keys()):
        with tempfile.TemporaryDirectory() as folder:
            _store(study.results, windows(Path(folder)))
    if not all(study.results.has(key) for key in pad_keys()):
        _store(study.results, pads())


def window_keys() -> list[str]:
    """Return where the results of growing windows stand."""
    return [f"cost/window/{frames}/{name}" for frames in WINDOWS for name in NETWORKS]


def pad_keys() -> list[str]:
    """Return where the results of growing numbers of pads stand."""
    return [f"cost/pads/{pads}/{way}" for pads in PADS for way in WAYS]


def windows(folder: Path) -> list[Timed]:
    """Return one answer of the shipped network and of the paper's over windows of each length.

    The paper's have random weights and one network a length; their files are written into `folder`.
    """
    classifier = Classifier.load(HAART_MODEL)
    timed = []
    for frames in WINDOWS:
        work = {"multiply_adds": multiply_adds(HAART_MODEL, frames)}
        answer = _answering(classifier, hand(frames)[np.newaxis])
        timed.append(Timed(f"cost/window/{frames}/{SHIPPED}", work, answer))
        timed += [_paper(PaperSettings(variant, frames), folder) for variant in VARIANTS]
    return timed


def pads(numbers: Sequence[int] = PADS) -> list[Timed]:
    """Return the answers of pads whose windows are due at one moment: in one batch, and one after another."""
    classifier = Classifier.load(HAART_MODEL)
    window = hand(PAD_FRAMES)[np.newaxis]
    alone = {"peak_bytes": peak_bytes(HAART_MODEL, PAD_FRAMES)}
    timed = []
    for number in numbers:
        together = {"peak_bytes": peak_bytes(HAART_MODEL, PAD_FRAMES, number)}
        batch = _answering(classifier, np.repeat(window, number, axis=0))
        timed.append(Timed(f"cost/pads/{number}/batched", together, batch))
        timed.append(Timed(f"cost/pads/{number}/single", alone, _answering(classifier, window, number)))
    return timed


def measure(timed: Sequence[Timed], answers: int) -> dict[str, dict[str, Any]]:
    """Time all in turn; return the values of each cell by its key."""
    timings = time_in_turn([each.answer for each in timed], answers)
    return {
        each.key: {**each.values, "answers_timed": answers, **timing_values(timing)}
        for each, timing in zip(timed, timings, strict=True)
    }


def fit(costs: Mapping[int, float], degree: int) -> Law:
    """Return the law of that degree with the least squared misses, each as a share of its cost.

    As shares, because costs of small and large sizes lie far apart. No term can be negative.
    """
    n, cost = np.array(list(costs), dtype=float), np.array(list(costs.values()))
    powers = np.stack([n**power for power in range(degree + 1)], axis=1)
    coefficients, _ = nnls(powers / cost[:, None], np.ones(len(cost)))
    misses = np.abs(powers @ coefficients / cost - 1.0)
    return Law(tuple(float(value) for value in coefficients), float(misses.max()))


def costs(results: Results, of: str, name: str, figure: str = "processor_ms") -> dict[int, float]:
    """Return a figure by size: of "window" and a network's name, or of "pads" and a way of answering."""
    keys = [key for key in results.keys(f"cost/{of}/") if key.endswith(f"/{name}")]
    return dict(sorted((int(key.split("/")[2]), results.get(key)[figure]) for key in keys))


def tables(results: Results) -> dict[str, str]:
    """Return the tables of this part: figures and fitted laws, for growing windows and numbers of pads."""
    lengths = [f"{frames} frames" for frames in costs(results, "window", SHIPPED)]
    law_headings = (
        *("network", "a, ms", "b, µs a frame", "c, ns a frame²", "largest miss"),
        *("of the time: a / b L / c L², %", "of the multiply-adds, %", "c L² overtakes b L at"),
    )
    return {
        "cost-windows": table(("network", *lengths), _window_rows(results)),
        "cost-window-laws": table(law_headings, _window_laws(results)),
        "cost-pads": table(
            ("pads", *WAYS.values(), "batch against single", "memory single / batch, MB"), _pad_rows(results)
        ),
        "cost-pad-laws": table(
            ("way", "a, ms", "b, ms a pad", "largest miss", f"pads within {FRAME_MS:.1f} ms"),
            _pad_laws(results),
        ),
    }


def draw(results: Results, figures: Path) -> None:
    """Draw the times and the laws fitted to them."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.6), layout="constrained")
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
    plt.close(figure)


def _store(results: Results, timed: Sequence[Timed]) -> None:
    began_s = time.perf_counter()
    measured = measure(timed, ANSWERS)
    for key, values in measured.items():
        results.put(key, values, (time.perf_counter() - began_s) / len(measured))


def _window_rows(results: Results) -> list[list[str]]:
    def row(network: str) -> list[str]:
        p50, p99 = (costs(results, "window", network, figure).values() for figure in ("p50_ms", "p99_ms"))
        return [f"{middle:.2f} / {high:.2f}" for middle, high in zip(p50, p99, strict=True)]

    return [[title, *row(network)] for network, title in NETWORKS.items()]


def _window_laws(results: Results) -> list[list[str]]:
    rows = []
    for network, title in NETWORKS.items():
        law, work = (
            fit(costs(results, "window", network, figure), degree=2)
            for figure in ("processor_ms", "multiply_adds")
        )
        a, b, c = law.coefficients
        splits = (
            " / ".join(f"{100 * share:.0f}" for share in each.shares(LENGTHS[-1])) for each in (law, work)
        )
        overtakes = f"{b / c:,.0f} frames" if c > 0 else "never"
        numbers = (f"{a:.3f}", f"{1e3 * b:.2f}", f"{1e6 * c:.1f}", f"{law.largest_miss:.0%}")
        rows.append([title, *numbers, *splits, overtakes])
    return rows


def _pad_rows(results: Results) -> list[list[str]]:
    rows = []
    for pads in costs(results, "pads", "single"):
        single, batched = (results.get(f"cost/pads/{pads}/{way}") for way in WAYS)
        times = (f"{way['p50_ms']:.2f} / {way['p99_ms']:.2f}" for way in (single, batched))
        memory = f"{single['peak_bytes'] / 1e6:.0f} / {batched['peak_bytes'] / 1e6:.0f}"
        rows.append([str(pads), *times, f"{batched['processor_ms'] / single['processor_ms']:.0%}", memory])
    return rows


def _pad_laws(results: Results) -> list[list[str]]:
    rows = []
    for way, title in WAYS.items():
        law = fit(costs(results, "pads", way), degree=1)
        a, b = law.coefficients
        rows.append([title, f"{a:.3f}", f"{b:.3f}", f"{law.largest_miss:.0%}", str(int((FRAME_MS - a) / b))])
    return rows


def _paper(settings: PaperSettings, folder: Path) -> Timed:
    torch.manual_seed(0)
    path = folder / f"{settings.variant}-{settings.frames}.onnx"
    export(PaperTGC(settings, len(GESTURES)).eval(), settings.frames, path)
    session, counts = open_session(path), hand(settings.frames)[np.newaxis]
    return Timed(
        f"cost/window/{settings.frames}/tgc-{settings.variant}",
        {"multiply_adds": multiply_adds(path, settings.frames)},
        lambda: session.run(None, {"counts": counts}),
    )


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
