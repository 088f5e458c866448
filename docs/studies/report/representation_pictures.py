"""The pictures of what is confused and of the learnt representation, one panel a network."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from model.training import metrics
from model.training.haart import GESTURES

CONFUSION_PICTURE = "report-confusion.png"
TSNE_PICTURE = "report-tsne.png"
DARK_PERCENT = 55
COLOURS = tuple(f"C{number}" for number in range(len(GESTURES)))


def stored_confusion(path: Path) -> NDArray[np.int64]:
    """Return the confusion counts (7, 7) of stored probabilities and labels."""
    with np.load(path) as stored:
        predicted = stored["probabilities"].argmax(axis=1).astype(np.int64)
        return metrics.confusion(predicted, stored["labels"].astype(np.int64), len(GESTURES))


def draw_confusions(confusions: Mapping[str, NDArray[np.int64]], path: Path) -> None:
    """Draw confusion counts (7, 7) in percent of each true gesture, one panel a network."""
    figure, panels = _panels(len(confusions), height=5.0)
    for axes, (name, counts) in zip(panels, confusions.items(), strict=False):
        shares = 100 * counts / counts.sum(axis=1, keepdims=True)
        axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
        for (row, column), share in np.ndenumerate(shares):
            colour = "white" if share > DARK_PERCENT else "black"
            axes.text(column, row, f"{share:.0f}", ha="center", va="center", color=colour, fontsize=8)
        axes.set_xticks(range(len(GESTURES)), GESTURES, rotation=45, ha="right")
        axes.set_yticks(range(len(GESTURES)), GESTURES)
        axes.set_title(name, fontsize=10)
    panels[0].set_ylabel("true gesture")
    _save(figure, path)


def draw_layouts(layouts: Mapping[str, Path], path: Path) -> None:
    """Draw stored points (N, 2) coloured by their gestures, one panel a network."""
    figure, panels = _panels(len(layouts), height=5.2)
    for axes, (name, stored) in zip(panels, layouts.items(), strict=False):
        with np.load(stored) as layout:
            points, labels = layout["points"].astype(np.float32), layout["labels"]
        for gesture, colour in enumerate(COLOURS):
            of_gesture = points[labels == gesture]
            axes.plot(
                of_gesture[:, 0], of_gesture[:, 1], ".", color=colour, markersize=4, label=GESTURES[gesture]
            )
        axes.set(xticks=[], yticks=[])
        axes.set_title(name, fontsize=10)
    if layouts:
        entries = panels[0].get_legend_handles_labels()
        figure.legend(*entries, loc="outside lower center", ncols=len(GESTURES), markerscale=2)
    _save(figure, path)


def _panels(count: int, height: float) -> tuple[Figure, list[Axes]]:
    figure, panels = plt.subplots(
        1, max(count, 1), figsize=(5.2 * max(count, 1), height), layout="constrained", squeeze=False
    )
    return figure, list(panels[0])


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=110)
    plt.close(figure)
