"""Measures what the daemon tells during a touch: docs/decision.md, for people, and docs/decision.json.

`python -m touchd.model.studies decision` plays HAART's training recordings, in some minutes.
The defaults of `speak_above` and `revise_margin` are the point that `choose` picks from the curve.
"""

import sys
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path

import msgspec
import numpy as np
from matplotlib.figure import Figure

from touchd.daemon.decide import DecisionSettings
from touchd.daemon.events import Stage
from touchd.daemon.pipeline import STAGES
from touchd.drivers.recording import NO_TOUCH, Recording
from touchd.model.classifier import SHIPPED_MODEL
from touchd.model.studies.decision.measure import Said, decide, listen
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.studies.tracker.measure import spliced
from touchd.model.training import haart
from touchd.model.training.metrics import expected_calibration_error
from touchd.model.training.ship import left_out_split

SPEAK_ABOVE = (0.4, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9)
# Below a tenth, noise would make the robot revise.
REVISE_MARGIN = (0.1, 0.2, 0.3, 0.4, 0.5)
LEAST_RIGHT_EARLY = 0.85
MOST_CHANGED = 0.10
MOST_HARMED = 0.02
# Half a point of 492 touches is two of them: chance.
AS_GOOD = 0.005


class StageFigures(msgspec.Struct, frozen=True, kw_only=True):
    """The network's own answers at one stage, told or not, over the touches that lasted so long."""

    stage: Stage
    touches: int
    accuracy: float
    calibration_error: float


class Point(msgspec.Struct, frozen=True, kw_only=True):
    """What the robot is told under one pair of settings; shares of the touches noticed, times in seconds."""

    speak_above: float
    revise_margin: float
    told_early: float
    right_when_told_early: float
    right_at_end: float
    changed: float
    """Touches whose told label was replaced at least once."""
    harmed: float
    """Touches in which a right told label was replaced by a wrong one."""
    median_settled_s: float
    """Median time of the first right answer that stayed, over the touches that have one."""

    @property
    def good(self) -> bool:
        """Whether it suits a scene: early answers trustworthy, changes rare, harm rarer."""
        return (
            self.right_when_told_early >= LEAST_RIGHT_EARLY
            and self.changed <= MOST_CHANGED
            and self.harmed <= MOST_HARMED
        )


class StreamReport(msgspec.Struct, frozen=True, kw_only=True):
    """The measurement: each stage, the curve over settings, and the point that became the default."""

    touches: int
    noticed: int
    stages: tuple[StageFigures, ...]
    default: Point
    curve: tuple[Point, ...]


def measure(recordings: Sequence[Recording], weights: Path = SHIPPED_MODEL.parent) -> StreamReport:
    """Measure on the training participants' whole scans, each answered by the network that never saw them.

    Every touching recording is played through the pipeline, and every pair of settings tried on the answers.
    """
    said: list[Said] = []
    labels: tuple[str, ...] = ()
    for classifier, held in left_out_split(weights, recordings):
        labels = classifier.labels
        said += listen(spliced(held, level_rest=True), classifier)
    default = DecisionSettings()
    return StreamReport(
        touches=sum(recording.gesture != NO_TOUCH for recording in recordings),
        noticed=len(said),
        stages=tuple(stage_figures(said, labels, stage) for stage in STAGES),
        default=point(said, labels, default.speak_above, default.revise_margin),
        curve=tuple(point(said, labels, *pair) for pair in product(SPEAK_ABOVE, REVISE_MARGIN)),
    )


def choose(curve: Iterable[Point]) -> Point:
    """Return the good point that tells early most often; among equals, the one that revises most readily.

    Points that are right at the end less often than the best by more than AS_GOOD do not count.
    """
    good = [candidate for candidate in curve if candidate.good]
    best = max(candidate.right_at_end for candidate in good)
    as_good = [candidate for candidate in good if candidate.right_at_end >= best - AS_GOOD]
    return max(as_good, key=lambda p: (p.told_early, -p.revise_margin))


def point(said: Sequence[Said], labels: tuple[str, ...], speak_above: float, revise_margin: float) -> Point:
    """Return what the robot would have been told under one pair of settings."""
    settings = DecisionSettings(speak_above=speak_above, revise_margin=revise_margin)
    told = [decide(touch, settings, labels) for touch in said]
    early = [t.right[0] for t in told if t.answers and t.answers[0][0] == "early"]
    settled = [t.settled_s for t in told if t.settled_s is not None]
    return Point(
        speak_above=speak_above,
        revise_margin=revise_margin,
        told_early=len(early) / len(told),
        right_when_told_early=float(np.mean(early)) if early else 1.0,
        right_at_end=len(settled) / len(told),
        changed=float(np.mean([len(t.right) > 1 for t in told])),
        harmed=float(np.mean([t.harmed for t in told])),
        median_settled_s=float(np.median(settled)) if settled else float("nan"),
    )


def stage_figures(said: Sequence[Said], labels: tuple[str, ...], stage: Stage) -> StageFigures:
    """Return how right, and how rightly confident, the network is at one stage."""
    rows = [(p, labels.index(t.gesture)) for t in said for name, _, p in t.answers if name == stage]
    probabilities = np.stack([p for p, _ in rows])
    truth = np.array([label for _, label in rows], dtype=np.int64)
    return StageFigures(
        stage=stage,
        touches=len(rows),
        accuracy=float((probabilities.argmax(axis=1) == truth).mean()),
        calibration_error=expected_calibration_error(probabilities, truth),
    )


def draw(figures: StreamReport, path: Path) -> None:
    """Draw how often the early answer is told against how often it is then right."""
    chosen = figures.default
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    along = [p for p in figures.curve if p.revise_margin == min(REVISE_MARGIN)]
    axes.plot([100 * p.told_early for p in along], [100 * p.right_when_told_early for p in along], marker="o")
    for p in along:
        at = (100 * p.told_early, 100 * p.right_when_told_early)
        axes.annotate(f"{p.speak_above:.2f}", at, textcoords="offset points", xytext=(4, 5), fontsize=8)
    axes.plot(
        100 * chosen.told_early, 100 * chosen.right_when_told_early, "r*", markersize=14, label="default"
    )
    axes.axhline(100 * LEAST_RIGHT_EARLY, color="grey", linewidth=0.8, linestyle=":")
    axes.set(xlabel="touches told after 1 s, %", ylabel="right when told, %")
    axes.legend(loc="lower left")
    figure.savefig(path, dpi=120)


def tables(figures: StreamReport) -> dict[str, str]:
    """Return the network's own answers at each stage, and what the robot is told along the curve.

    Of the curve, where one of the settings is the default's; the file has every pair.
    """
    default = figures.default
    stages = [
        ("noticed", f"{figures.noticed} of {figures.touches}", "", ""),
        *(
            (row.stage, row.touches, _percent(row.accuracy), f"{row.calibration_error:.3f}")
            for row in figures.stages
        ),
    ]
    curve = [
        (
            f"{p.speak_above:.2f}",
            f"{p.revise_margin:.2f}" + (" (default)" if p == default else ""),
            *map(_percent, (p.told_early, p.right_when_told_early, p.right_at_end, p.changed, p.harmed)),
            f"{p.median_settled_s:.2f} s",
        )
        for p in figures.curve
        if p.speak_above == default.speak_above or p.revise_margin == default.revise_margin
    ]
    shares = ("told early", "right when told early", "right at the end", "changed", "harmed")
    return {
        "stages": table(("stage", "touches", "right", "calibration error"), stages),
        "curve": table(("speak_above", "revise_margin", *shares, "right for good after"), curve),
    }


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def main(arguments: Sequence[str]) -> int:
    """Measure, write decision.md, decision.json and the curve's picture; say which point the rule picks."""
    options = study_parser("decision", __doc__, "haart", "docs").parse_args(arguments)
    docs = options.docs
    figures = measure(haart.realigned(haart.read_training(options.haart)))
    (docs / "decision.json").write_bytes(msgspec.json.format(msgspec.json.encode(figures)) + b"\n")
    draw(figures, docs / "figures" / "decision.png")
    fill(docs / "decision.md", tables(figures), others=("sure",))
    sys.stdout.write(f"{docs / 'decision.md'}; the rule picks {choose(figures.curve)}\n")
    return 0
