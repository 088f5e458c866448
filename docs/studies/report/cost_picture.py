"""Cost as a picture: the time of an answer against the window and the number of pads, with the laws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from docs.studies.report.cost_page import (
    NETWORKS,
    WAYS,
    measured,
    pad_law,
    pad_times,
    window_law,
    window_times,
)
from docs.studies.report.law import Law
from docs.studies.report.networks import SHIPPED
from docs.studies.report.results import Results

COLOURS = ("#1f5fa8", "#c4611a", "#7a3f98")


def draw(results: Results, path: Path) -> None:
    """Draw what has been measured; nothing where any of it is missing."""
    if not measured(results):
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    figure, (windows, panel) = plt.subplots(1, 2, figsize=(12, 4.6), layout="constrained")
    for colour, (network, title) in zip(COLOURS, NETWORKS.items(), strict=True):
        _curve(windows, window_times(results, network), window_law(results, network).at, colour, title)
    windows.set(title="one answer, as its window grows", xlabel="frames in the window", yscale="log")
    windows.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    _ticks(windows, list(window_times(results, SHIPPED)))
    windows.set_ylabel("processor time, ms")
    for colour, (way, title) in zip(COLOURS, WAYS.items(), strict=False):
        each = {pads: time / pads for pads, time in pad_times(results, way).items()}
        _curve(panel, each, _a_pad(pad_law(results, way)), colour, title)
    panel.set(title="touchd over 144 frames, as pads are added", xlabel="pads due at one moment")
    panel.set_ylabel("processor time a pad, ms")
    panel.margins(y=0.2)
    panel.set_ylim(bottom=0)
    _ticks(panel, list(pad_times(results, "single")))
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _curve(
    axes: Axes, times: Mapping[int, float], law: Callable[[float], float], colour: str, title: str
) -> None:
    sizes = np.geomspace(min(times), max(times), 100)
    axes.plot(sizes, [law(size) for size in sizes], color=colour, linewidth=1.2)
    axes.plot(list(times), list(times.values()), "o", color=colour, label=title)


def _a_pad(law: Law) -> Callable[[float], float]:
    return lambda pads: law.at(pads) / pads


def _ticks(axes: Axes, sizes: Sequence[int]) -> None:
    axes.set(xscale="log")
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.minorticks_off()
    axes.grid(True, linewidth=0.3, color="0.85")
    axes.legend(frameon=False, title="measured, and the law fitted to it", loc="best")
