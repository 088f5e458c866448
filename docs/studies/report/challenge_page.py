"""How table 1 is shown: the table in Markdown, and a picture of what was published beside what came of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from docs.studies.report.challenge_kinds import System
from docs.studies.report.challenge_systems import SYSTEMS
from docs.studies.report.markdown import percent, provenance, table
from docs.studies.report.paper_cells import Variant, trained_cells, trained_networks
from docs.studies.report.paper_tables import PAPER_EPOCHS, accuracies, describe
from docs.studies.report.results import Results

PREFIX = "table1/"
PICTURE = "report-challenge.png"
LENGTHS = (432, 144, 81, 54)
SCORES = ("accuracy", "macro_accuracy")
NOT_RUN = "not run"
PAPER_TGC = 72.8
PAPER_TGC_FRAMES = 144


def cell_key(system: System, frames: int, seed: int) -> str:
    """Return the key of a cell: values windows, accuracy, macro_accuracy and answers, a digit a window."""
    return f"{PREFIX}{system.key}/frames{frames}/seed{seed}"


def chosen_key(system: System) -> str:
    """Return the key of a system's chosen settings."""
    return f"{PREFIX}{system.key}/chosen"


def measured(results: Results, system: System, frames: int, score: str) -> list[float]:
    """Return each seed's score, "accuracy" or "macro_accuracy", as far as they are there."""
    keys = [cell_key(system, frames, seed) for seed in system.seeds]
    return [results.get(key)[score] for key in keys if results.has(key)]


def lines(results: Results) -> Iterator[str]:
    """Yield the section's lines."""
    headings = ["researchers", "classifier", "published"]
    for frames in LENGTHS:
        headings += [f"{frames} frames", "macro"]
    yield from table(headings, [*_system_rows(results), *_paper_rows(results)])
    yield from NOTES.splitlines()
    yield from _not_run(results)
    yield ""
    yield from _chosen(results)
    yield f"![Published and own accuracy](figures/{PICTURE})"
    yield ""
    if results.keys(PREFIX):
        yield f"Made by {provenance(results, PREFIX)}."
        yield ""


NOTES = """
Published is what the paper's table 1 prints: accuracy over whole recordings of 432 frames, 8 s, for the
challenge's systems; macro accuracy at 144 frames, of the epoch that did best on test, for TGC. Ours: plain
and macro accuracy in percent, mean ± sd over three seeds (an SVM has none), over the windows as published;
training participants train, and the test file gives these figures and nothing else. touchd is trained on
realigned frames, and asked here over the published ones.

**What these are not.** Each system follows its paper's abstract and what later papers say of it; the text of
the sections on features and networks was not at hand. Which features and layers, of the kinds named there,
is our choice, said in each one's module (`model/study/challenge_*.py`). A figure above the published one
corrects nothing, and one below refutes nothing. scikit-learn has no AdaBoost.MH; SAMME stands in for
multiboosting.

**What was cut.** The floating search is done once, over whole recordings, with forests of 20 trees in three
folds. Hughes' networks are trained once for all lengths, on crops of 144 frames, for as many epochs as served
two left-out training participants best, of at most 24 (CNN, CRNN) or 40. Boosting has 100 rounds. A large
spread is a training that went wrong from one of its seeds; it is not left out.
""".strip()


def _system_rows(results: Results) -> Iterator[list[str]]:
    for system in SYSTEMS:
        published = "" if system.published is None else f"{system.published:.1f}"
        row = [system.researchers, system.algorithm, published]
        for frames in LENGTHS:
            row += [percent(measured(results, system, frames, score)) or NOT_RUN for score in SCORES]
        yield row


def _not_run(results: Results) -> Iterator[str]:
    missing = [
        f"{system.researchers}, {system.algorithm}"
        for system in SYSTEMS
        if any(len(measured(results, system, frames, SCORES[0])) < len(system.seeds) for frames in LENGTHS)
    ]
    if missing:
        yield ""
        yield f"Not run to the end, for want of time: {'; '.join(missing)}."
        yield "`python -m docs.studies report --only challenge` goes on from here."


def _paper_rows(results: Results) -> Iterator[list[str]]:
    yield [
        "Ren et al. 2023",
        "TGC, Transformer",
        f"{PAPER_TGC} ({PAPER_TGC_FRAMES} frames)",
        *[""] * 2 * len(LENGTHS),
    ]
    networks = {(variant, blocks) for variant, blocks, _ in trained_networks(results)}
    for variant, blocks in sorted(networks, key=lambda network: (network[0] != "public", -network[1])):
        row = ["Ren et al., made again", f"TGC, {describe(variant, blocks)}", ""]
        for frames in LENGTHS:
            row += ["", _last_epoch(results, variant, blocks, frames)]
        if any(row[3:]):
            yield row


def _last_epoch(results: Results, variant: Variant, blocks: int, frames: int) -> str:
    cells = trained_cells(results, variant, blocks, frames)
    if not cells:
        return ""
    epochs = f" (epoch {cells[0].epochs} of {PAPER_EPOCHS})"
    return percent([accuracies(results, cell)[-1] for cell in cells]) + epochs


def _chosen(results: Results) -> Iterator[str]:
    rows = []
    for system in SYSTEMS:
        if results.has(chosen_key(system)) and results.get(chosen_key(system))["settings"]:
            chosen = results.get(chosen_key(system))
            settings = system.in_words(chosen["settings"])
            rows.append(
                (system.researchers, system.algorithm, settings, f"{100 * chosen['left_out_accuracy']:.1f}")
            )
    if rows:
        yield "Chosen on training participants who were left out, and the accuracy on them:"
        yield ""
        yield from table(("researchers", "classifier", "chosen", "left out"), rows)


def draw(results: Results, figures: Path) -> None:
    """Draw a line a system: what was published, and what ours gives at each length, with its spread."""
    figure, axes = plt.subplots(figsize=(7.4, 5.2), layout="constrained")
    places = np.arange(len(SYSTEMS))[::-1]
    for number, frames in enumerate(LENGTHS):
        for place, system in zip(places, SYSTEMS, strict=True):
            values = [100 * value for value in measured(results, system, frames, "accuracy")]
            if values:
                spread = np.std(values, ddof=1) if len(values) > 1 else 0.0
                label = f"ours, {frames} frames" if system is SYSTEMS[0] else None
                lower = place - 0.13 * (number - (len(LENGTHS) - 1) / 2)
                axes.errorbar(np.mean(values), lower, xerr=spread, fmt="o", color=f"C{number}", label=label)
    known = [
        (system.published, place) for place, system in zip(places, SYSTEMS, strict=True) if system.published
    ]
    axes.plot(*zip(*known, strict=True), "kD", fillstyle="none", label="published, 432 frames")
    axes.axvline(PAPER_TGC, color="grey", linestyle=":", label=f"TGC as published, {PAPER_TGC_FRAMES} frames")
    axes.set_yticks(places, [f"{system.researchers}, {system.algorithm}" for system in SYSTEMS], fontsize=8)
    axes.set(xlabel="accuracy on test, %")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    figure.savefig(figures / PICTURE, dpi=120)
    plt.close(figure)
