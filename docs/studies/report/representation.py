"""The paper's figures 2 and 3, for its network and ours: confusions, and the representation's layout.

Over the test participants' windows of 144 frames as published. The representation is the last layer's input;
t-SNE (van der Maaten and Hinton 2008) lays it out in the plane.
"""

import logging
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sklearn.manifold import TSNE
from torch import Tensor, nn

from docs.studies.accuracy import draw_shares
from docs.studies.marked import table
from docs.studies.report import paper_training
from docs.studies.report.paper_cells import (
    PaperCell,
    describe,
    layout_path,
    predictions_path,
    trained_cells,
    trained_networks,
)
from docs.studies.report.results import Results, Study, percent
from docs.studies.report.tables23 import our_key
from docs.studies.training import checkpoint, haart, metrics
from docs.studies.training.haart import GESTURES, Windows
from docs.studies.training.ship import HAART_MODEL

log = logging.getLogger(__name__)

FRAMES = 144
PERPLEXITY = 30.0
BATCH = 64
OURS = "representation/ours"
CONFUSION_PICTURE = "report-confusion.png"
TSNE_PICTURE = "report-tsne.png"
COLOURS = tuple(f"C{number}" for number in range(len(GESTURES)))


def run(study: Study) -> None:
    """Lay out both representations, where the results lack them."""
    torch.set_num_threads(study.threads)
    if not study.results.has(OURS):
        _lay_out(study, OURS, our_representation())
    paper = shown_cell(study.results)
    if paper is None or study.results.has(paper_key(paper)):
        return
    if paper_training.is_at(study, paper):
        _lay_out(study, paper_key(paper), paper_training.trained(study, paper).features)
    else:
        log.warning("%s: its last epoch is not in %s; no t-SNE of it", paper.training, study.checkpoints)


def tables(results: Results) -> dict[str, str]:
    """Return how often the nearest window of another participant shows the same gesture."""
    paper = shown_cell(results)
    keys = {"touchd": OURS} if paper is None else {name(paper): paper_key(paper), "touchd": OURS}
    rows = [
        (network, results.get(key)["features"], percent([results.get(key)["nearest_agree"]]))
        for network, key in keys.items()
        if results.has(key)
    ]
    heading = "windows whose nearest one of another participant is of the same gesture, %"
    return {"representation": table(("network", "width", heading), rows)}


def draw(results: Results, figures: Path) -> None:
    """Draw the confusion matrices, and the layouts, where they are there."""
    paper = shown_cell(results)
    confusions, layouts = {}, {}
    if paper is not None:
        confusions[name(paper)] = stored_confusion(predictions_path(figures.parent, paper))
        if results.has(paper_key(paper)):
            layouts[name(paper)] = layout_path(figures.parent, paper_key(paper))
    own = our_key("published", FRAMES)
    if results.has(own):
        confusions["touchd"] = np.array(results.get(own)["confusions"][0])
    if results.has(OURS):
        layouts["touchd"] = layout_path(figures.parent, OURS)
    draw_confusions(confusions, figures / CONFUSION_PICTURE)
    draw_layouts(layouts, figures / TSNE_PICTURE)


def shown_cell(results: Results) -> PaperCell | None:
    """Return the trained cell that stands for the paper's network: the longest trained, then the deepest.

    Seven and eight blocks are excluded, as the paper's own choice is six.
    """
    cells = [
        trained_cells(results, variant, blocks, frames)[0]
        for variant, blocks, frames in trained_networks(results)
        if frames == FRAMES and blocks <= 6
    ]
    return max(cells, key=lambda cell: (cell.epochs, cell.blocks, cell.variant == "public"), default=None)


def name(cell: PaperCell) -> str:
    """Return which of the paper's networks it is, and how long it was trained, in words."""
    return f"the paper's, {describe(cell.variant, cell.blocks)}, {cell.epochs} epochs"


def our_representation() -> nn.Module:
    """Return the shipped network up to its last layer: (B, T, 8, 8) counts to (B, dense)."""
    network = checkpoint.load(HAART_MODEL.with_suffix(".pt")).build()
    network.dense[-1] = nn.Identity()
    return network


def nearest_agree(features: NDArray[np.float64], windows: Windows) -> float:
    """Return the share of windows whose nearest one of another participant is of the same gesture."""
    squares = (features * features).sum(axis=1)
    distances = squares[:, None] + squares[None, :] - 2.0 * features @ features.T  # (N, N)
    distances[windows.participants[:, None] == windows.participants[None, :]] = np.inf
    return float((windows.labels[distances.argmin(axis=1)] == windows.labels).mean())


def paper_key(cell: PaperCell) -> str:
    """Return the key of the paper's layout among the results."""
    return f"representation/{cell.key}"


def _lay_out(study: Study, key: str, represent: Callable[[Tensor], Tensor]) -> None:
    began = time.perf_counter()
    windows = haart.cut(haart.read_test(study.haart), FRAMES)
    counts = torch.from_numpy(windows.counts.astype(np.float32))
    with torch.no_grad():
        features = torch.cat([represent(batch) for batch in torch.split(counts, BATCH)]).numpy()
    points = TSNE(perplexity=PERPLEXITY, init="pca", random_state=0).fit_transform(features)
    path = layout_path(study.docs, key)
    path.parent.mkdir(parents=True, exist_ok=True)
    labels = windows.labels.astype(np.uint8)
    np.savez_compressed(path, points=points.astype(np.float16), labels=labels)
    values = {
        "features": features.shape[1],
        "perplexity": PERPLEXITY,
        "nearest_agree": round(nearest_agree(features.astype(np.float64), windows), 4),
    }
    study.results.put(key, values, time.perf_counter() - began)


def stored_confusion(path: Path) -> NDArray[np.int64]:
    """Return the confusion counts (7, 7) of stored probabilities and labels."""
    with np.load(path) as stored:
        predicted = stored["probabilities"].argmax(axis=1).astype(np.int64)
        return metrics.confusion(predicted, stored["labels"].astype(np.int64), len(GESTURES))


def draw_confusions(confusions: Mapping[str, NDArray[np.int64]], path: Path) -> None:
    """Draw confusion counts (7, 7) in percent of each true gesture, one panel a network."""
    figure, panels = _panels(len(confusions), height=5.0)
    for axes, (name, counts) in zip(panels, confusions.items(), strict=False):
        draw_shares(axes, counts, GESTURES)
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
