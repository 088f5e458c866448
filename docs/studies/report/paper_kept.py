"""The smallest of the paper's networks, kept with the page: small enough to be stored, and to be asked again.

Its weights are kept in float16, which halves the file; the test asks it again over all test windows.
"""

from __future__ import annotations

import os
from pathlib import Path

import torch

from docs.studies.report import paper_training
from docs.studies.report.paper_cells import STORED_FOLDER, PaperCell, trained_cells
from docs.studies.report.paper_tgc import PaperSettings, PaperTGC
from docs.studies.report.results import Results
from docs.studies.report.study import Study
from model.training.haart import GESTURES

FRAMES = 144


def kept_cell(results: Results) -> PaperCell | None:
    """Return the cell whose network is kept: the public code's, of one block; None when it is not trained."""
    return next(iter(trained_cells(results, "public", 1, FRAMES)), None)


def keep(study: Study) -> None:
    """Store the kept cell's network, where it is not stored yet and its checkpoint is at hand."""
    cell = kept_cell(study.results)
    if cell is None or kept_path(study.docs, cell).exists() or not paper_training.is_at(study, cell):
        return
    network = paper_training.trained(study, cell)
    weights = {
        name: value.half() if value.is_floating_point() else value
        for name, value in network.state_dict().items()
    }
    path = kept_path(study.docs, cell)
    for older in path.parent.glob(f"{cell.training}-epochs*.pt"):
        older.unlink()
    partial = path.with_suffix(".partial")
    torch.save(weights, partial)
    os.replace(partial, path)


def load_kept(docs: Path, cell: PaperCell) -> PaperTGC:
    """Return the kept network, ready to answer in float32."""
    network = PaperTGC(PaperSettings(cell.variant, cell.frames, cell.blocks), len(GESTURES))
    network.load_state_dict(torch.load(kept_path(docs, cell), map_location="cpu", weights_only=True))
    return network.eval()


def kept_path(docs: Path, cell: PaperCell) -> Path:
    """Return where the kept network lies."""
    return docs / STORED_FOLDER / f"{cell.training}-epochs{cell.epochs}.pt"
