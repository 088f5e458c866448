"""The accuracy page: the machine-written scores as tables and pictures for people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from model.checks.evaluate import SCENE, Evaluation, Score, Scores, read_scores
from model.settings import LENGTHS

PAPER_ACCURACY = {9: 57.0, 27: 66.6, 54: 70.8, 72: 71.1, 108: 72.3, 144: 72.8, 216: 71.6}
"""Table 3 of Ren, Hou and Belpaeme (HRI 2023), percent; its "1.5 seconds" are 72 frames."""


def main(arguments: Sequence[str]) -> int:
    """Write the page from the stored scores; returns 0."""
    scores, page = map(
        Path, (*arguments, *("model/weights/scores.json", "docs/accuracy.md")[len(arguments) :])
    )
    write_page(read_scores(scores), page)
    return 0


def write_page(scores: Scores, page: Path) -> None:
    """Write the page, in Markdown, and its pictures beside it in figures/."""
    figures = page.parent / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    draw_accuracy(scores, figures / "accuracy.png")
    draw_confusion(scores.labels, scores.test, figures / "confusion.png")
    page.write_text("\n".join(page_lines(scores)) + "\n", encoding="utf-8")


def draw_accuracy(scores: Scores, path: Path) -> None:
    """Draw accuracy against time since the touch began, ours and the paper's."""
    figure, axes = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for name, evaluation in (("test participants", scores.test), ("training, left out", scores.left_out)):
        rows = evaluation.realigned
        seconds = [row.frames / 54 for row in rows]
        axes.plot(seconds, [100 * row.accuracy for row in rows], marker="o", label=f"touchd, {name}")
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
        counts = np.array(_at(evaluation, length).confusion)
        shares = 100 * counts / counts.sum(axis=1, keepdims=True)
        axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
        for (row, column), share in np.ndenumerate(shares):
            colour = "white" if share > 55 else "black"
            axes.text(column, row, f"{share:.0f}", ha="center", va="center", color=colour, fontsize=8)
        axes.set_xticks(range(len(labels)), labels, rotation=45, ha="right")
        axes.set_yticks(range(len(labels)), labels)
        axes.set_title(f"after {length / 54:.2f} s")
    panels[0].set_ylabel("true gesture")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def page_lines(scores: Scores) -> Iterable[str]:
    """Yield the page's lines."""
    yield "# How accurate the classifier is"
    yield ""
    yield f"Model `{scores.model}` (sha256 {scores.model_sha256[:16]}…), written by `{scores.command}` on"
    yield f"{scores.machine}. The figures come from `scores.json` beside the model."
    yield ""
    yield "Windows and macro accuracy as in the paper: each recording cut into 432 // L windows of L frames."
    yield "**Test**: the challenge's participants T1, T2 and T9; nothing was chosen on them."
    yield "**Left out**: the training participants, each answered by a network that never saw them."
    yield "The interval is a 95 % bootstrap over participants. One file answers at every length."
    yield ""
    yield "![Accuracy against time](figures/accuracy.png)"
    yield ""
    yield from _seed_table(scores)
    for name, evaluation in (
        ("Test participants", scores.test),
        ("Training participants, left out", scores.left_out),
    ):
        yield f"## {name}"
        yield ""
        yield from _length_table(evaluation)
        yield from _class_table(scores.labels, evaluation)
        yield from _disturbance_table(evaluation)
    yield "## What is confused (test, realigned)"
    yield ""
    yield "![Confusion at the three answers](figures/confusion.png)"


def _seed_table(scores: Scores) -> Iterable[str]:
    yield "The same recipe from other seeds, on the test participants, realigned; the first ships:"
    yield ""
    yield f"| seed | {' | '.join(f'{length} frames' for length in LENGTHS)} |"
    yield f"|---{'|---' * len(LENGTHS)}|"
    for seed, accuracies in scores.seeds.items():
        yield f"| {seed} | {' | '.join(_percent(accuracies[str(length)]) for length in LENGTHS)} |"
    columns = [[100 * row[str(length)] for row in scores.seeds.values()] for length in LENGTHS]
    yield f"| **mean ± sd** | {' | '.join(f'{np.mean(c):.1f} ± {np.std(c, ddof=1):.1f}' for c in columns)} |"
    yield ""


def _length_table(evaluation: Evaluation) -> Iterable[str]:
    yield "| frames | seconds | paper (test) | realigned | 95 % interval | published | calibration error |"
    yield "|---|---|---|---|---|---|---|"
    for live, published in zip(evaluation.realigned, evaluation.published, strict=True):
        paper = f"{PAPER_ACCURACY[live.frames]:.1f}" if live.frames in PAPER_ACCURACY else ""
        low, high = live.interval
        yield (
            f"| {live.frames} | {live.frames / 54:.2f} | {paper} | **{_percent(live.accuracy)}** "
            f"| {_percent(low)} to {_percent(high)} | {_percent(published.accuracy)} "
            f"| {live.calibration_error:.3f} |"
        )
    yield ""


def _class_table(labels: Sequence[str], evaluation: Evaluation) -> Iterable[str]:
    rows = [_at(evaluation, length) for length in LENGTHS]
    people = sorted(rows[0].per_participant)
    yield f"| frames | {' | '.join(labels)} | {' | '.join(people)} | scene of {', '.join(SCENE)} |"
    yield f"|---{'|---' * (len(labels) + len(people) + 1)}|"
    for row in rows:
        gestures = " | ".join(_percent(row.per_class[label]) for label in labels)
        participants = " | ".join(_percent(row.per_participant[name]) for name in people)
        scene = f"{_percent(row.scene_accuracy)} (unrestricted {_percent(row.scene_unrestricted_accuracy)})"
        yield f"| {row.frames} | {gestures} | {participants} | {scene} |"
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
