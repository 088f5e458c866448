"""The accuracy page, from the stored scores: `python -m touchd.model.studies accuracy`.

`python -m touchd.model.studies evaluate --write` stores the scores.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from touchd.drivers.frame import FRAME_RATE_HZ, OTHER
from touchd.model.settings import LENGTHS
from touchd.model.studies.checks.evaluate import SCENE, Evaluation, Score
from touchd.model.studies.checks.scores import Scores, read_scores
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, percent, table
from touchd.model.studies.published import TABLE3
from touchd.model.training.weights import SCORES_NAME

TITLES: Mapping[str, str] = MappingProxyType(
    {
        "test": "HAART test",
        "left_out": "HAART held out",
        "second_study": "second study",
        "third_study": "third study",
        "new_pad": "a pad never met",
        "cross_study": "second study, from HAART alone",
    }
)
"""Columns and rows of the tables, by fields of `Scores`."""
DETAILED = ("test", "left_out", "second_study", "third_study", "new_pad")
FINAL = LENGTHS[-1]
COLOURS = ("#1f5fa8", "#5b9bd5", "#2a8a57", "#8fc4a5", "#7a3f98", "#b89cc9")
DARK_PERCENT = 55
LABEL_GAP = 1.7
"""Least distance between the labels of two lines, in percent."""


def main(arguments: Sequence[str]) -> int:
    """Fill the page's tables and draw its figures; returns 0."""
    options = study_parser("accuracy", __doc__, "docs", "weights").parse_args(arguments)
    scores = read_scores(options.weights / SCORES_NAME)
    fill(options.docs / "accuracy.md", tables(scores))
    figures = options.docs / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    draw_accuracy(scores, figures / "accuracy.png")
    draw_confusion(scores, figures / "confusion.png")
    return 0


def tables(scores: Scores) -> dict[str, str]:
    """Return the page's tables by their places; all but the first are of the shipped recipe's networks."""
    sets = {TITLES[key]: getattr(scores, key) for key in DETAILED if key != "new_pad"}
    final = {title: at(evaluation, FINAL) for title, evaluation in sets.items()}
    everybody = {TITLES[key]: at(getattr(scores, key), FINAL) for key in DETAILED}
    scene = f"only {', '.join(SCENE)} possible"
    lengths = [f"{length / FRAME_RATE_HZ:.2f} s" for length in LENGTHS]
    gestures = [label for label in scores.labels if label != OTHER]
    return {
        "model": f"Model: `{scores.model}`, sha256 {scores.model_sha256[:16]}….",
        "summary": table(
            ("people", *lengths, "calibration error"),
            [_summary(title, getattr(scores, key)) for key, title in TITLES.items()],
        ),
        "gestures": table(
            ("gesture", *final),
            [
                *((label, *(_share(each.per_class, label) for each in final.values())) for label in gestures),
                (scene, *(percent(each.scene_accuracy) for each in final.values())),
            ],
        ),
        "people": table(
            ("people", "worst person", "median", "best", "worst condition", "best"),
            [
                (title, *_spread(each.per_participant), *_extremes(each.per_condition))
                for title, each in everybody.items()
            ],
        ),
    }


def at(evaluation: Evaluation, length: int) -> Score:
    """Return the score over windows of one length, in live framing."""
    return next(row for row in evaluation.realigned if row.frames == length)


def draw_accuracy(scores: Scores, path: Path) -> None:
    """Draw accuracy against time since the touch began, ours and the paper's."""
    figure = Figure(figsize=(7.2, 4.0), layout="constrained")
    axes = figure.subplots()
    lines = {
        title: [(row.frames / FRAME_RATE_HZ, 100 * row.accuracy) for row in getattr(scores, key).realigned]
        for key, title in TITLES.items()
    }
    lines["the paper, HAART test"] = [(frames / FRAME_RATE_HZ, printed) for frames, printed in TABLE3.items()]
    label_percent = np.inf
    for title, points in sorted(lines.items(), key=lambda line: -line[1][-1][1]):
        colour = COLOURS[list(TITLES.values()).index(title)] if title in TITLES.values() else "#c4611a"
        axes.plot(*zip(*points, strict=True), "o-", color=colour, markersize=3)
        end_s, end_percent = points[-1]
        label_percent = min(end_percent, label_percent - LABEL_GAP)
        axes.annotate(title, (end_s + 0.08, label_percent), va="center", color=colour, fontsize=8)
    for length in LENGTHS:
        axes.axvline(length / FRAME_RATE_HZ, color="grey", linewidth=0.6, linestyle=":")
    axes.set(xlabel="seconds of touch seen", ylabel="macro accuracy, %", xlim=(0, 6.2), ylim=(45, 90))
    axes.set_xticks(range(5))
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=120)


def draw_confusion(scores: Scores, path: Path) -> None:
    """Draw confusions of the final answer in percent of each true gesture, a panel per set of people."""
    figure = Figure(figsize=(19, 4.6), layout="constrained")
    panels = figure.subplots(1, len(DETAILED), sharey=True)
    for axes, key in zip(panels, DETAILED, strict=True):
        draw_shares(axes, np.array(at(getattr(scores, key), FINAL).confusion), scores.labels)
        axes.set_title(TITLES[key])
    panels[0].set_ylabel("true gesture")
    figure.savefig(path, dpi=110)


def draw_shares(axes: Axes, counts: NDArray[np.int64], labels: Sequence[str]) -> None:
    """Draw confusion counts (C, C) in percent of each true gesture; no window is truly `other`."""
    true = [place for place, label in enumerate(labels) if label != OTHER]
    shares = 100 * counts[true] / np.maximum(counts[true].sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
    for (row, column), share in np.ndenumerate(shares):
        colour = "white" if share > DARK_PERCENT else "black"
        axes.text(column, row, f"{share:.0f}", ha="center", va="center", color=colour, fontsize=8)
    axes.set_xticks(range(len(labels)), labels, rotation=45, ha="right")
    axes.set_yticks(range(len(true)), [labels[place] for place in true])


def _summary(title: str, evaluation: Evaluation) -> tuple[str, ...]:
    answers = [at(evaluation, length) for length in LENGTHS]
    error = max(row.calibration_error for row in answers)
    return title, *(percent(row.accuracy) for row in answers), f"{error:.2f}"


def _spread(shares: Mapping[str, float]) -> tuple[str, ...]:
    """Return the lowest, the median and the highest share in percent."""
    own = 100 * np.array(list(shares.values()))
    return tuple(f"{share:.0f}" for share in (own.min(), np.median(own), own.max()))


def _extremes(shares: Mapping[str, float]) -> tuple[str, ...]:
    """Return the condition of the lowest share, and of the highest."""
    ordered = sorted(shares.items(), key=lambda item: item[1])
    return tuple(f"{name}: {100 * share:.0f}" for name, share in (ordered[0], ordered[-1]))


def _share(shares: Mapping[str, float], label: str) -> str:
    return percent(shares[label]) if label in shares else ""
