"""What tables 2 and 3 share: training their cells, and how the paper's trained networks are written down."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import torch

from docs.studies.report import paper_training
from docs.studies.report.markdown import percent, provenance, table
from docs.studies.report.paper_cells import (
    PREFIX,
    PaperCell,
    Variant,
    parse,
    read_grid,
    trained_cells,
    trained_networks,
)
from docs.studies.report.results import Results
from docs.studies.report.study import Study

PAPER_EPOCHS = 100
HEADINGS = ("network", "seeds", "epochs", "best epoch on test", "last epoch")


def train(study: Study, wanted: Callable[[PaperCell], bool]) -> None:
    """Train the wanted cells that the grid names and the results lack."""
    grid = read_grid()
    for entry in grid.whole if torch.cuda.is_available() else grid.feasible:
        for cell in filter(wanted, entry.cells()):
            if not study.results.has(cell.key):
                paper_training.train(study, grid, cell)


def rows(results: Results, networks: Sequence[tuple[Variant, int]], frames: int) -> list[list[str]]:
    """Return what stands under HEADINGS, a row a network of this many frames; one that says so for none."""
    found = []
    for variant, blocks in networks:
        cells = trained_cells(results, variant, blocks, frames)
        seeds, epochs = str(len(cells)), f"{cells[0].epochs} of {PAPER_EPOCHS}"
        best = percent([max(accuracies(results, cell)) for cell in cells])
        last = percent([accuracies(results, cell)[-1] for cell in cells])
        found.append([describe(variant, blocks), seeds, epochs, best, f"**{last}**"])
    return found or [["not trained", "", "", "", ""]]


def describe(variant: Variant, blocks: int) -> str:
    """Return which of the paper's networks it is, in words."""
    return f"{variant}, {blocks} block{'s' if blocks > 1 else ''}"


def accuracies(results: Results, cell: PaperCell) -> list[float]:
    """Return the macro accuracy on the test windows after each epoch."""
    measured: list[float] = results.get(cell.key)["accuracies"]
    return measured


def what_was_cut(results: Results) -> Iterator[str]:
    """Yield how much of the whole grid is trained; nothing when all of it is."""
    whole = {cell for entry in read_grid().whole for cell in entry.cells()}
    done = {cell for cell in whole if results.has(cell.key)}
    if done == whole:
        return
    cells = sorted((parse(key) for key in results.keys(PREFIX)), key=lambda cell: cell.epochs)
    started = {cell.training: cell.epochs for cell in cells}
    epochs = sum(started.values())
    yield f"**What was cut.** The whole grid is {len(whole)} trainings of {PAPER_EPOCHS} epochs. Without a"
    yield f"GPU, {len(done)} of them could be finished; {len(started)} were begun, {epochs} epochs in all."
    yield "The tables say how far each came, and what is not trained. Where there is a GPU, the same command"
    yield "trains the rest."
    yield ""


def makings(results: Results) -> Iterator[str]:
    """Yield the table of every trained network: how large, how long it took, and what made it."""
    headings = ("network", "frames", "epochs", "seed", "weights", "hours", "made by")
    lines = []
    for variant, blocks, frames in trained_networks(results):
        for cell in trained_cells(results, variant, blocks, frames):
            weights = f"{results.get(cell.key)['parameters']:,}"
            hours = f"{results.cell(cell.key).seconds / 3600:.1f}"
            what = (describe(variant, blocks), str(frames), str(cell.epochs), str(cell.seed))
            lines.append((*what, weights, hours, provenance(results, cell.key)))
    yield from table(headings, lines)
