"""The paper's table 3: test accuracy against the length of the window, the paper's network and ours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from docs.studies.report import ours, paper_tables
from docs.studies.report.markdown import percent, provenance, table
from docs.studies.report.paper_cells import trained_cells, trained_networks
from docs.studies.report.paper_tables import HEADINGS, accuracies, describe
from docs.studies.report.results import Results
from docs.studies.report.study import Study
from drivers.frame import FRAME_RATE_HZ
from model.checks.evaluate import REPORTED_LENGTHS

PICTURE = "report-learning.png"
BLOCKS = 6
PAPER = {
    9: "57.0 ± 1.9",
    27: "66.6 ± 1.3",
    54: "70.8 ± 1.5",
    72: "71.1 ± 1.4",
    108: "72.3 ± 1.2",
    144: "72.8 ± 1.8",
    216: "71.6 ± 1.0",
}
"""Percent, six blocks; what it calls 1.5 seconds are 72 frames. It has no 81."""


def run(study: Study) -> None:
    """Score our network, then train the paper's where a length is missing."""
    ours.run(study)
    paper_tables.train(study, lambda cell: True)


def section(results: Results) -> str:
    """Return the table and the picture of how the networks learnt, in Markdown."""
    return "\n".join(_lines(results))


def draw(results: Results, figures: Path) -> None:
    """Draw the paper's networks' test accuracy after each epoch that was trained."""
    figure, axes = plt.subplots(figsize=(7.4, 4.2), layout="constrained")
    for variant, blocks, frames in trained_networks(results):
        cells = trained_cells(results, variant, blocks, frames)
        for number, cell in enumerate(cells):
            learnt = [100 * accuracy for accuracy in accuracies(results, cell)]
            name = f"{describe(variant, blocks)}, {frames} frames"
            (line,) = axes.plot(range(1, len(learnt) + 1), learnt, label=name if number == 0 else None)
            axes.plot(len(learnt), learnt[-1], "o", color=line.get_color())
    axes.set_xscale("log")
    axes.set(xlabel="epochs trained, of the paper's 100", ylabel="macro accuracy on test, %", xlim=(1, 100))
    axes.set_xticks([1, 2, 5, 10, 20, 50, 100], ["1", "2", "5", "10", "20", "50", "100"])
    axes.grid(alpha=0.3)
    if trained_networks(results):
        axes.legend(fontsize=8)
    figure.savefig(figures / PICTURE, dpi=120)
    plt.close(figure)


def _lines(results: Results) -> Iterator[str]:
    yield from table(
        ("frames", "seconds", "the paper prints", *HEADINGS, "touchd", "touchd, live framing"),
        _rows(results),
    )
    yield "touchd is one network for all lengths, mean ± sd over three seeds, the first of which ships;"
    yield "nothing about it was chosen on these participants. Its first column is over the very windows that"
    yield "the paper's network gets, the second over frames as a pad sends them, without the files' seam."
    yield f"Scored by {provenance(results, 'ours/')}."
    yield ""
    yield f"![What the paper's networks had learnt after each epoch](figures/{PICTURE})"
    yield ""
    yield "Test accuracy of the paper's networks after each epoch, with a dot at the last. Where a curve"
    yield "still rises at its dot, the table shows less than the network can do in the paper's 100 epochs."
    yield f"Made by {provenance(results, 'paper/')}."
    yield ""


def _rows(results: Results) -> Iterator[list[str]]:
    for frames in REPORTED_LENGTHS:
        networks = [
            (variant, blocks) for variant, blocks, length in trained_networks(results) if length == frames
        ]
        own = [percent(ours.accuracies(results, framing, frames)) for framing in ours.FRAMINGS]
        leading = [str(frames), f"{frames / FRAME_RATE_HZ:.2f}", PAPER.get(frames, "")]
        for row in paper_tables.rows(results, networks, frames):
            yield [*leading, *row, *own]
