"""The accuracy page: the machine-written scores as tables and pictures for people."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from touchd.model.classifier import SHIPPED_MODEL
from touchd.model.settings import LENGTHS
from touchd.model.studies.checks.evaluate import SCENE, Evaluation, Score, Scores, read_scores
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table

TABLE3 = {
    9: "57.0 ± 1.9",
    27: "66.6 ± 1.3",
    54: "70.8 ± 1.5",
    72: "71.1 ± 1.4",
    108: "72.3 ± 1.2",
    144: "72.8 ± 1.8",
    216: "71.6 ± 1.0",
}
"""Of Ren, Hou and Belpaeme (HRI 2023), percent, six blocks; its "1.5 seconds" are 72 frames. It has no 81."""
PAPER_ACCURACY = {frames: float(printed.split()[0]) for frames, printed in TABLE3.items()}

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
    parser = study_parser("accuracy", __doc__, "docs")
    parser.add_argument("--weights", type=Path, default=SHIPPED_MODEL.parent, help="folder of scores.json")
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
    model = (
        f"Model `{scores.model}` (sha256 {scores.model_sha256[:16]}…), scored by `{scores.command}` on\n"
        f"{scores.machine}."
    )
    evaluations = {name: _evaluation(getattr(scores, name)) for name in TITLES}
    return {"model": model, "summary": _summary(scores), **evaluations}


def draw_accuracy(scores: Scores, path: Path) -> None:
    """Draw accuracy against time since the touch began, ours and the paper's."""
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axes = figure.subplots()
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


def draw_confusion(labels: Sequence[str], evaluation: Evaluation, path: Path) -> None:
    """Draw the confusion matrices at the three answers, in percent of each true gesture."""
    figure = Figure(figsize=(13, 4.6), layout="constrained")
    panels = figure.subplots(1, len(LENGTHS), sharey=True)
    for axes, length in zip(panels, LENGTHS, strict=True):
        draw_shares(axes, np.array(_at(evaluation, length).confusion), labels)
        axes.set_title(f"after {length / 54:.2f} s")
    panels[0].set_ylabel("true gesture")
    figure.savefig(path, dpi=110)


def draw_shares(axes: Axes, counts: NDArray[np.int64], labels: Sequence[str]) -> None:
    """Draw confusion counts (C, C) in percent of each true gesture."""
    shares = 100 * counts / counts.sum(axis=1, keepdims=True)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
    for (row, column), share in np.ndenumerate(shares):
        colour = "white" if share > DARK_PERCENT else "black"
        axes.text(column, row, f"{share:.0f}", ha="center", va="center", color=colour, fontsize=8)
    axes.set_xticks(range(len(labels)), labels, rotation=45, ha="right")
    axes.set_yticks(range(len(labels)), labels)


def _summary(scores: Scores) -> str:
    rows = []
    for title, evaluation in (
        *((title, getattr(scores, name)) for name, title in TITLES.items()),
        ("from HAART alone to the second study", scores.cross_study),
    ):
        answers = [_at(evaluation, length) for length in LENGTHS]
        errors = ", ".join(f"{row.calibration_error:.3f}" for row in answers)
        rows.append((title, *(f"**{_percent(row.accuracy)}**" for row in answers), errors))
    lengths = [f"{length / 54:.2f} s ({length} frames)" for length in LENGTHS]
    return table(("", *lengths, "calibration error"), rows)


def _evaluation(evaluation: Evaluation) -> str:
    rows = [_at(evaluation, length) for length in LENGTHS]
    scene = (f"scene of {', '.join(SCENE)}", *(_percent(row.scene_accuracy) for row in rows))
    plain = evaluation.disturbed["none"]
    disturbed = [
        (name, _percent(accuracy), f"{100 * (accuracy - plain):+.1f}")
        for name, accuracy in evaluation.disturbed.items()
    ]
    return "\n\n".join(
        (
            _lengths(evaluation),
            _shares("gesture", [row.per_class for row in rows], scene),
            _shares("person", [row.per_participant for row in rows]),
            _shares("condition", [row.per_condition for row in rows]),
            f"After {LENGTHS[-1]} frames, when the pad or the hand is not what it was in training:",
            table(("disturbance", "accuracy", "change in points"), disturbed),
        )
    )


def _lengths(evaluation: Evaluation) -> str:
    published = {row.frames: _percent(row.accuracy) for row in evaluation.published}
    rows = [
        (
            row.frames,
            f"{row.frames / 54:.2f}",
            PAPER_ACCURACY.get(row.frames, ""),
            f"**{_percent(row.accuracy)}**",
            " to ".join(map(_percent, row.interval)),
            published.get(row.frames, ""),
            f"{row.calibration_error:.3f}",
        )
        for row in evaluation.realigned
    ]
    headings = ("frames", "seconds", "paper (test)", "realigned", "95 % interval", "published")
    return table((*headings, "calibration error"), rows)


def _shares(heading: str, shares: Sequence[dict[str, float]], *more: Sequence[str]) -> str:
    rows = [(name, *(_percent(each[name]) for each in shares)) for name in sorted(shares[0])]
    return table((heading, *(f"{length} frames" for length in LENGTHS)), [*rows, *more])


def _at(evaluation: Evaluation, length: int) -> Score:
    return next(row for row in evaluation.realigned if row.frames == length)


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"
