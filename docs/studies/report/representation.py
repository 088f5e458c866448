"""The paper's figures 2 and 3, for its network and ours: what is confused, and how the representation lies.

Over the test participants' windows of 144 frames as published. The representation is what the last layer
gets; t-SNE (van der Maaten and Hinton 2008) lays it out in the plane.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.manifold import TSNE
from torch import Tensor, nn

from docs.studies.report import ours, paper_training, representation_pictures
from docs.studies.report.markdown import percent, provenance, table
from docs.studies.report.paper_cells import (
    PaperCell,
    layout_path,
    predictions_path,
    trained_cells,
    trained_networks,
)
from docs.studies.report.paper_tables import describe
from docs.studies.report.representation_pictures import CONFUSION_PICTURE, TSNE_PICTURE
from docs.studies.report.results import Results
from docs.studies.report.study import Study
from model.classifier import SHIPPED_MODEL
from model.training import checkpoint, haart
from model.training.haart import Windows

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
    if paper is None or study.results.has(paper_key(paper)):
        return
    if paper_training.is_at(study, paper):
        _lay_out(study, paper_key(paper), paper_training.trained(study, paper).features)
    else:
        log.warning("%s: its last epoch is not in %s; no t-SNE of it", paper.training, study.checkpoints)


def section(results: Results) -> str:
    """Return both pictures with their captions, in Markdown."""
    return "\n".join(_lines(results))


def draw(results: Results, figures: Path) -> None:
    """Draw the confusion matrices, and the layouts, where they are there."""
    paper = shown_cell(results)
    confusions, layouts = {}, {}
    if paper is not None:
        confusions[name(paper)] = representation_pictures.stored_confusion(
            predictions_path(figures.parent, paper)
        )
        if results.has(paper_key(paper)):
            layouts[name(paper)] = layout_path(figures.parent, paper_key(paper))
    own = ours.key("published", FRAMES)
    if results.has(own):
        confusions["touchd"] = np.array(results.get(own)["confusions"][0])
    if results.has(OURS):
        layouts["touchd"] = layout_path(figures.parent, OURS)
    representation_pictures.draw_confusions(confusions, figures / CONFUSION_PICTURE)
    representation_pictures.draw_layouts(layouts, figures / TSNE_PICTURE)


def shown_cell(results: Results) -> PaperCell | None:
    """Return the trained cell that stands for the paper's network: the longest trained, then the deepest.

    Seven and eight blocks stand aside, as the paper's own choice is six.
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
    network = checkpoint.load(SHIPPED_MODEL.with_suffix(".pt")).build()
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


def _lines(results: Results) -> Iterator[str]:
    paper = shown_cell(results)
    if paper is None:
        yield "None of the paper's networks is trained at 144 frames yet; run"
        yield "`python -m docs.studies report --only table3`."
        yield ""
    yield f"![What is confused after 144 frames](figures/{CONFUSION_PICTURE})"
    yield ""
    yield "Figure 2: rows are the true gesture, in percent of its windows; test participants, 144 frames as"
    yield "published. touchd is the shipped file."
    if paper is not None:
        yield f"The paper's network: {provenance(results, paper.key)}."
    yield f"touchd: {provenance(results, ours.key('published', FRAMES))}."
    yield ""
    yield f"![The learnt representations](figures/{TSNE_PICTURE})"
    yield ""
    yield f"Figure 3: t-SNE (perplexity {PERPLEXITY:.0f}) of what each network's last layer gets, a dot a"
    yield f"window; by {provenance(results, 'representation/')}."
    yield ""
    yield "In figures rather than by eye, before t-SNE:"
    yield ""
    yield from table(
        ("network", "width", "windows whose nearest one of another participant is of the same gesture, %"),
        _agreement_rows(results, paper),
    )


def _agreement_rows(results: Results, paper: PaperCell | None) -> Iterator[list[str]]:
    keys = {"touchd": OURS} if paper is None else {name(paper): paper_key(paper), "touchd": OURS}
    for network, key in keys.items():
        if results.has(key):
            values = results.get(key)
            yield [network, str(values["features"]), percent([values["nearest_agree"]])]
        else:
            yield [network, "", "missing"]
