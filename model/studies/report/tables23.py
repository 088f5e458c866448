"""The paper's tables 2 and 3: test accuracy against encoder blocks and window length, its network and ours.

The paper does not print the length of its windows in table 2; 144 frames are taken, as in its public code.
"""

import time
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import torch
from matplotlib.figure import Figure

from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.model.classifier import Classifier
from touchd.model.studies.accuracy import TABLE3
from touchd.model.studies.checks import evaluate
from touchd.model.studies.checks.evaluate import REPORTED_LENGTHS
from touchd.model.studies.marked import table
from touchd.model.studies.report import paper_training
from touchd.model.studies.report.paper_cells import (
    PAPER_EPOCHS,
    PaperCell,
    accuracies,
    describe,
    read_grid,
    trained,
)
from touchd.model.studies.report.results import Results, Study, percent
from touchd.model.training import haart
from touchd.model.training.ship import HAART_MODEL, SEEDS_FOLDER

FRAMINGS = ("published", "realigned")
TABLE2_FRAMES = 144
TABLE2 = dict(
    enumerate(
        (
            "65.6 ± 2.3",
            "65.9 ± 4.8",
            "67.9 ± 1.6",
            "68.6 ± 2.0",
            "68.9 ± 1.8",
            "69.8 ± 2.2",
            "69.5 ± 0.8",
            "69.4 ± 0.9",
        ),
        start=1,
    )
)
"""Percent, by blocks."""
HEADINGS = ("network", "seeds", "epochs", "best epoch on test", "last epoch")


def run(study: Study) -> None:
    """Score our network, then train the paper's where a cell of the grid is missing."""
    _score_ours(study)
    grid = read_grid()
    for entry in grid.whole if torch.cuda.is_available() else grid.feasible:
        for cell in entry.cells():
            if not study.results.has(cell.key):
                paper_training.train(study, grid, cell)


def tables(results: Results) -> dict[str, str]:
    """Return both tables, and how each of the paper's networks was made."""
    networks = trained(results)
    by_length = [
        (frames, f"{frames / FRAME_RATE_HZ:.2f}", TABLE3.get(frames, ""), *row, *_own(results, frames))
        for frames in REPORTED_LENGTHS
        for row in _rows(results, [cells for network, cells in networks.items() if network[2] == frames])
    ]
    by_blocks = [
        (blocks, printed, *row)
        for blocks, printed in TABLE2.items()
        for row in _rows(
            results, [cells for network, cells in networks.items() if network[1:] == (blocks, TABLE2_FRAMES)]
        )
    ]
    made = [
        (
            *(describe(cell.variant, cell.blocks), cell.frames, cell.epochs, cell.seed),
            f"{results.get(cell.key)['parameters']:,}",
            f"{results.cell(cell.key).seconds / 3600:.1f}",
            results.cell(cell.key).commit,
        )
        for cells in networks.values()
        for cell in cells
    ]
    return {
        "table3": table(
            ("frames", "seconds", "the paper prints", *HEADINGS, "touchd", "touchd, live framing"), by_length
        ),
        "table2": table(("blocks", "the paper prints", *HEADINGS), by_blocks),
        "trainings": table(("network", "frames", "epochs", "seed", "weights", "hours", "commit"), made),
    }


def draw(results: Results, figures: Path) -> None:
    """Draw the paper's networks' test accuracy after each epoch that was trained."""
    figure = Figure(figsize=(7.4, 4.2), layout="constrained")
    axes = figure.subplots()
    for (variant, blocks, frames), cells in trained(results).items():
        for number, cell in enumerate(cells):
            learnt = [100 * accuracy for accuracy in accuracies(results, cell)]
            name = f"{describe(variant, blocks)}, {frames} frames"
            (line,) = axes.plot(range(1, len(learnt) + 1), learnt, label=name if number == 0 else None)
            axes.plot(len(learnt), learnt[-1], "o", color=line.get_color())
    axes.set_xscale("log")
    axes.set(xlabel="epochs trained, of the paper's 100", ylabel="macro accuracy on test, %", xlim=(1, 100))
    axes.set_xticks([1, 2, 5, 10, 20, 50, 100], ["1", "2", "5", "10", "20", "50", "100"])
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(figures / "report-learning.png", dpi=120)


def model_files() -> list[Path]:
    """Return the shipped file, then those of the recipe's further seeds."""
    return [HAART_MODEL, *sorted((HAART_MODEL.parent / SEEDS_FOLDER).glob("*.onnx"))]


def our_key(framing: str, frames: int) -> str:
    """Return where our networks' scores stand among the results."""
    return f"ours/{framing}/frames{frames}"


def _score_ours(study: Study) -> None:
    missing = [each for each in product(FRAMINGS, REPORTED_LENGTHS) if not study.results.has(our_key(*each))]
    if not missing:
        return
    published = haart.read_test(study.haart)
    recordings = {"published": published, "realigned": haart.realigned(published)}
    classifiers = [Classifier.load(path, study.threads) for path in model_files()]
    for framing, frames in missing:
        began = time.perf_counter()
        scores = [evaluate.score([(each, recordings[framing])], frames) for each in classifiers]
        values = {
            "windows": scores[0].windows,
            "accuracies": [round(score.accuracy, 5) for score in scores],
            "confusions": [score.confusion for score in scores],
        }
        study.results.put(our_key(framing, frames), values, time.perf_counter() - began)


def _own(results: Results, frames: int) -> list[str]:
    return [percent(results.get(our_key(framing, frames))["accuracies"]) for framing in FRAMINGS]


def _rows(results: Results, networks: Sequence[Sequence[PaperCell]]) -> list[Sequence[object]]:
    """Return what stands under HEADINGS, a row a network; one that says so where there is none."""
    found: list[Sequence[object]] = []
    for cells in networks:
        name, epochs = describe(cells[0].variant, cells[0].blocks), f"{cells[0].epochs} of {PAPER_EPOCHS}"
        best, last = (
            percent([of(accuracies(results, cell)) for cell in cells]) for of in (max, lambda each: each[-1])
        )
        found.append((name, len(cells), epochs, best, f"**{last}**"))
    return found or [("not trained", "", "", "", "")]
