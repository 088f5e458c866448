"""The paper's figures 2 and 3, for its network and ours: confusions, and the representation's layout.

Over the test participants' windows of 144 frames as published. The representation is the last layer's input;
t-SNE (van der Maaten and Hinton 2008) lays it out in the plane.
"""

import logging
import time
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sklearn.manifold import TSNE
from torch import Tensor, nn

from touchd.model.studies.accuracy import draw_shares
from touchd.model.studies.marked import table
from touchd.model.studies.report import paper_training
from touchd.model.studies.report.paper_cells import STORED_FOLDER, PaperCell, describe, trained
from touchd.model.studies.report.results import Results, Study, percent
from touchd.model.studies.report.tables23 import our_key
from touchd.model.training import checkpoint, haart, metrics
from touchd.model.training.haart import GESTURES, Windows
from touchd.model.training.ship import HAART_MODEL

log = logging.getLogger(__name__)

FRAMES = 144
PERPLEXITY = 30.0
BATCH = 64
OURS = "representation/ours"


def run(study: Study) -> None:
    """Lay out both representations, where the results lack them."""
    torch.set_num_threads(study.threads)
    if not study.results.has(OURS):
        _lay_out(study, OURS, our_representation())
    paper = shown_cell(study.results)
    if study.results.has(paper_key(paper)):
        return
    network = paper_training.trained(study, paper)
    if network is None:
        log.warning("%s: its last epoch is not in %s; no t-SNE of it", paper.training, study.checkpoints)
    else:
        _lay_out(study, paper_key(paper), network.features)


def tables(results: Results) -> dict[str, str]:
    """Return how often the nearest window of another participant shows the same gesture."""
    rows = [
        (network, results.get(key)["features"], percent([results.get(key)["nearest_agree"]]))
        for network, key in _laid_out(results).items()
    ]
    heading = "windows whose nearest one of another participant is of the same gesture, %"
    return {"representation": table(("network", "width", heading), rows)}


def draw(results: Results, figures: Path) -> None:
    """Draw the confusion matrices in percent of each true gesture, and the layouts coloured by gesture."""
    paper = shown_cell(results)
    confusions = {
        name(paper): stored_confusion(paper.stored(figures.parent)),
        "touchd": np.array(results.get(our_key("published", FRAMES))["confusions"][0]),
    }
    figure, panels = _panels(confusions, height=5.0)
    for axes, counts in zip(panels, confusions.values(), strict=True):
        draw_shares(axes, counts, GESTURES)
    panels[0].set_ylabel("true gesture")
    figure.savefig(figures / "report-confusion.png", dpi=110)

    layouts = _laid_out(results)
    figure, panels = _panels(layouts, height=5.2)
    for axes, key in zip(panels, layouts.values(), strict=True):
        with np.load(layout_path(figures.parent, key)) as layout:
            points, labels = layout["points"].astype(np.float32), layout["labels"]
        for number, gesture in enumerate(GESTURES):
            axes.plot(*points[labels == number].T, ".", color=f"C{number}", markersize=4, label=gesture)
        axes.set(xticks=[], yticks=[])
    entries = panels[0].get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", ncols=len(GESTURES), markerscale=2)
    figure.savefig(figures / "report-tsne.png", dpi=110)


def shown_cell(results: Results) -> PaperCell:
    """Return the trained cell that stands for the paper's network: the longest trained, then the deepest.

    Seven and eight blocks are excluded, as the paper's own choice is six.
    """
    cells = [
        cells[0]
        for (_, blocks, frames), cells in trained(results).items()
        if frames == FRAMES and blocks <= 6
    ]
    return max(cells, key=lambda cell: (cell.epochs, cell.blocks, cell.variant == "public"))


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


def layout_path(docs: Path, key: str) -> Path:
    """Return where a representation's layout lies: points (N, 2) float16, labels (N,)."""
    return docs / STORED_FOLDER / f"tsne-{key.removeprefix('representation/').replace('/', '-')}.npz"


def _laid_out(results: Results) -> dict[str, str]:
    """Return the keys of the layouts by their networks; the paper's only where its weights were at hand."""
    paper = shown_cell(results)
    keys = {name(paper): paper_key(paper), "touchd": OURS}
    return {network: key for network, key in keys.items() if results.has(key)}


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


def _panels(titles: Collection[str], height: float) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(5.2 * len(titles), height), layout="constrained")
    panels = figure.subplots(1, len(titles), squeeze=False)[0]
    for axes, title in zip(panels, titles, strict=True):
        axes.set_title(title, fontsize=10)
    return figure, list(panels)
