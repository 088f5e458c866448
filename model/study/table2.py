"""The paper's table 2: test accuracy against the number of encoder blocks, at 144 frames."""

from __future__ import annotations

import torch

from model.study import paper_training
from model.study.paper_cells import read_grid
from model.study.study import Study

FRAMES = 144


def run(study: Study) -> None:
    """Train the cells that the grid names and the results lack."""
    grid = read_grid()
    for entry in grid.whole if torch.cuda.is_available() else grid.feasible:
        for cell in entry.cells():
            if cell.frames == FRAMES and not study.results.has(cell.key):
                paper_training.train(study, grid, cell)
