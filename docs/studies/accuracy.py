"""The accuracy page: the machine-written scores as tables and pictures for people."""

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from docs.studies.checks.evaluate import SCENE, Evaluation, Score, Scores, read_scores
from docs.studies.folders import add_docs_argument
from docs.studies.marked import fill
from model.classifier import SHIPPED_MODEL
from model.settings import LENGTHS

PAPER_ACCURACY = {9: 57.0, 27: 66.6, 54: 70.8, 72: 71.1, 108: 72.3, 144: 72.8, 216: 71.6}
"""Table 3 of Ren, Hou and Belpaeme (HRI 2023), percent; its "1.5 seconds" are 72 frames."""


TITLES = {
    "test": "HAART, test participants",
    "left_out": "HAART, training participants left out",
    "second_study": "second study, people left out",
}
PLACES = ("model", "summary", *TITLES)
SEEDS, ONE_OUT = "seeds", "one_out"
"""The places that the studies of these names fill."""
DARK_PERCENT = 55


def main(arguments: Sequence[str]) -> int:
    """Write the page's tables and figures from the stored scores; returns 0."""
    parser = argparse.ArgumentParser(prog="python -m docs.studies accuracy", description=__doc__)
    parser.add_argument("--weights", type=Path, default=SHIPPED_MODEL.parent, help="folder of scores.json")
    add_docs_argument(parser)
    options = parser.parse_args(arguments)
    scores = read_scores(options.weights / "scores.json")
    page, figures = options.docs / "accuracy.md", options.docs / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    draw_accuracy(scores, figures / "accuracy.png")
    draw_confusion(scores.labels, scores.test, figures / "confusion.png")
    draw_confusion(scores.labels, scores.second_study, figures / "confusion-second-study.png")
    fill(page, tables(scores), others=(SEEDS, ONE_OUT))
    return 0


def tables(scores: Scores) -> dict[str, str]:
    """Return the page's tables by name."""
    lines = {"model": _model_lines(scores), "summary": _summary_table(scores)}
    for name in TITLES:
        lines[name] = _evaluation_tables(getattr(scores, name))
    return {name: "\n".join(each) for name, each in lines.items()}


def draw_accuracy(scores: Scores, path: Path) -> None:
    """Draw accuracy against time since the touch began, ours and the paper's."""
    figure, axes = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for name, title in TITLES.items():
        rows = getattr(scores, name).realigned
        seconds = [row.frames / 54 for row in rows]
        axes.plot(seconds, [100 * row.accuracy for row in rows], marker="o", label=f"touchd, {title}")
    paper = list(PAPER_ACCURACY.values())
    axes.plot([frames / 54 for frames in PAPER_ACCURACY], paper, "k--", marker="s", label="paper, test")
    for length in LENGTHS:
        axes.axvline(length / 54, color="grey", linewidth=0.6, linestyle=":")
    axes.set(xlabel="seconds of touch seen", ylabel="macro accuracy, %", ylim=(40, 95))
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def draw_confusion(labels: Sequence[str], evaluation: Evaluation, path: Path) -> None:
    """Draw the confusion matrices at the three answers, in percent of each true gesture."""
    figure, panels = plt.subplots(1, len(LENGTHS), figsize=(13, 4.6), layout="constrained", sharey=True)
    for axes, length in zip(panels, LENGTHS, strict=True):
        draw_shares(axes, np.array(_at(evaluation, length).confusion), labels)
        axes.set_title(f"after {length / 54:.2f} s")
    panels[0].set_ylabel("true gesture")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_shares(axes: Axes, counts: NDArray[np.int64], labels: Sequence[str]) -> None:
    """Draw confusion counts (C, C) in percent of each true gesture."""
    shares = 100 * counts / counts.sum(axis=1, keepdims=True)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
    for (row, column), share in np.ndenumerate(shares):
        colour = "white" if share > DARK_PERCENT else "black"
        axes.text(column, row, f"{share:.0f}", ha="center", va="center", color=colour, fontsize=8)
    axes.set_xticks(range(len(labels)), labels, rotation=45, ha="right")
    axes.set_yticks(range(len(labels)), labels)


def _model_lines(scores: Scores) -> Iterable[str]:
    yield f"Model `{scores.model}` (sha256 {scores.model_sha256[:16]}…), scored by `{scores.command}` on"
    yield f"{scores.machine}."
    yield ""


def _summary_table(scores: Scores) -> Iterable[str]:
    lengths = " | ".join(f"{length / 54:.2f} s ({length} frames)" for length in LENGTHS)
    yield f"| | {lengths} | calibration error |"
    yield f"|---{'|---' * (len(LENGTHS) + 1)}|"
    for title, evaluation in (
        *((title, getattr(scores, name)) for name, title in TITLES.items()),
        ("from HAART alone to the second study", scores.cross_study),
    ):
        rows = [_at(evaluation, length) for length in LENGTHS]
        shares = " | ".join(f"**{_percent(row.accuracy)}**" for row in rows)
        yield f"| {title} | {shares} | {', '.join(f'{row.calibration_error:.3f}' for row in rows)} |"
    yield ""


def _evaluation_tables(evaluation: Evaluation) -> Iterable[str]:
    yield from _length_table(evaluation)
    yield from _share_table("gesture", evaluation, lambda row: row.per_class)
    yield from _share_table("person", evaluation, lambda row: row.per_participant)
    yield from _share_table("condition", evaluation, lambda row: row.per_condition)
    yield from _disturbance_table(evaluation)


def _length_table(evaluation: Evaluation) -> Iterable[str]:
    yield "| frames | seconds | paper (test) | realigned | 95 % interval | published | calibration error |"
    yield "|---|---|---|---|---|---|---|"
    published = {row.frames: _percent(row.accuracy) for row in evaluation.published}
    for live in evaluation.realigned:
        paper = f"{PAPER_ACCURACY[live.frames]:.1f}" if live.frames in PAPER_ACCURACY else ""
        low, high = live.interval
        yield (
            f"| {live.frames} | {live.frames / 54:.2f} | {paper} | **{_percent(live.accuracy)}** "
            f"| {_percent(low)} to {_percent(high)} | {published.get(live.frames, '')} "
            f"| {live.calibration_error:.3f} |"
        )
    yield ""


def _share_table(
    heading: str, evaluation: Evaluation, shares: Callable[[Score], dict[str, float]]
) -> Iterable[str]:
    rows = [_at(evaluation, length) for length in LENGTHS]
    yield f"| {heading} | {' | '.join(f'{length} frames' for length in LENGTHS)} |"
    yield f"|---{'|---' * len(LENGTHS)}|"
    for name in sorted(shares(rows[0])):
        yield f"| {name} | {' | '.join(_percent(shares(row)[name]) for row in rows)} |"
    if heading == "gesture":
        scene = " | ".join(_percent(row.scene_accuracy) for row in rows)
        yield f"| scene of {', '.join(SCENE)} | {scene} |"
    yield ""


def _disturbance_table(evaluation: Evaluation) -> Iterable[str]:
    plain = evaluation.disturbed["none"]
    yield f"After {LENGTHS[-1]} frames, when the pad or the hand is not what it was in training:"
    yield ""
    yield "| disturbance | accuracy | change in points |"
    yield "|---|---|---|"
    for name, accuracy in evaluation.disturbed.items():
        yield f"| {name} | {_percent(accuracy)} | {100 * (accuracy - plain):+.1f} |"
    yield ""


def _at(evaluation: Evaluation, length: int) -> Score:
    return next(row for row in evaluation.realigned if row.frames == length)


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"
