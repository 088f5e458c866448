"""When to tell the robot, and how often the answer is right: `python -m touchd.model.studies decision`.

Each gesture is spliced between notouch recordings of the same participant and condition, as in
`touchd.model.studies.cases`. The daemon's tracker finds the touch, and a network that never saw
the person answers after each of its first 144 frames. All settings of the daemon's decision are tried on
these answers.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from touchd.daemon.path.decide import FINAL_ABOVE, REVISE_MARGIN, Decision, DecisionSettings, sure_above
from touchd.daemon.path.events import UNCERTAIN, Stage
from touchd.daemon.path.pipeline import STAGES
from touchd.drivers.frame import FRAME_RATE_HZ, MAX_COUNT
from touchd.model.classifier import Classifier, ModelState
from touchd.model.studies.cases import LEAD_FRAMES, Case, first_touch, spliced
from touchd.model.studies.checks.evaluate import Split, score
from touchd.model.studies.folders import (
    HELD_OUT,
    SECOND,
    STUDIES,
    TEST,
    THIRD,
    folders_of,
    never_seen,
    study_parser,
)
from touchd.model.studies.marked import fill, percent, table
from touchd.model.studies.play import detector_for
from touchd.model.studies.published import TABLE3
from touchd.model.studies.results import STORED, keep
from touchd.model.training import haart, metrics
from touchd.model.training.studies import MISSING
from touchd.model.training.weights import FABRIC_MODEL, left_out_split

FILE = STORED / "decision.json"
FRAMES = 144
REST_FRAMES = 60
"""Notouch before a touch; the tracker learns the rest in half a second."""
MARKS = DecisionSettings().answer_at_frames
SPEAK_ABOVE = (0.4, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9)
MARGINS = (0.1, 0.2, 0.3, 0.4, 0.5)
"""A margin below a tenth would let noise revise an answer."""
EARLIEST_FRAMES = 9
"""The first frame at which the challenge's windows are answered, about a sixth of a second."""
LIMITS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
"""Confidences after 1 s at which an early answer counts as sure."""
SHOWN = (0.5, 0.8)
"""Values of `speak_above` in the page's table, beside the default."""
FINAL = (0.0, 0.3, 0.4, 0.45, 0.5, 0.6, 0.7)
"""Values of `final_above`; the page's table has those of FINAL_SHOWN."""
FINAL_SHOWN = (0.0, FINAL_ABOVE, 0.5)
NAMED = (0.4, 0.65, 0.75, 0.85)
"""Values of `speak_above` that the right panel names; others would lie on other lines."""
LABELS_AT = ((1.0, 89.4), (1.1, 80.2), (1.1, 68.0))
"""Places of the left panel's labels: seconds, percent."""
NEVER_MET = "a pad never met"


@dataclass(frozen=True, eq=False)
class Streams:
    """The answers to N touches after each of their first FRAMES frames, and their true gestures.

    probabilities: (N, FRAMES, labels). truth: (N,) indices of labels. detected: (N,) the frame of the
    touch at which the tracker detected it; nothing can be told before.
    """

    probabilities: NDArray[np.float32]
    truth: NDArray[np.int64]
    detected: NDArray[np.int64]
    participants: NDArray[np.str_]
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Told:
    """The answers that the robot was told of one touch: seconds since it began, and whether right."""

    answers: tuple[tuple[Stage, float, bool], ...]

    @property
    def right(self) -> list[bool]:
        """Whether each answer was right."""
        return [right for *_, right in self.answers]

    @property
    def harmed(self) -> bool:
        """Whether a right answer was replaced by a wrong one."""
        return any(before and not after for before, after in pairwise(self.right))

    @property
    def settled(self) -> bool:
        """Whether the last answer was right."""
        return self.right[-1:] == [True]


class StageFigures(msgspec.Struct, frozen=True, kw_only=True):
    """The network's own answers at one stage, told or not."""

    stage: Stage
    accuracy: float
    calibration_error: float


class Point(msgspec.Struct, frozen=True, kw_only=True):
    """Answers told to the robot under one pair of settings, as shares of the touches."""

    speak_above: float
    revise_margin: float
    told_early: float
    right_when_told_early: float
    right_at_end: float
    changed: float
    """Touches with a replaced answer."""
    harmed: float
    """Touches with a right answer replaced by a wrong one."""


class Choice(msgspec.Struct, frozen=True, kw_only=True):
    """Cost of `scene.early`. first: of the first answer told; right: of the last."""

    early: str
    first_mean_s: float
    first_right: float
    right: float
    harmed: float


class AtFinal(msgspec.Struct, frozen=True, kw_only=True):
    """Percent of touches that are named rightly in the end under one `final_above`, and of those named."""

    final_above: float
    right: float
    right_of_named: float


class StudyFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Everything measured on one study's people."""

    people: int
    touches: int
    stages: tuple[StageFigures, ...]
    curve: tuple[Point, ...]
    final: tuple[AtFinal, ...]
    choices: tuple[Choice, ...]


class AtLimit(msgspec.Struct, frozen=True, kw_only=True):
    """The challenge's test windows, answered once the confidence reaches a limit, or at the end."""

    limit: float
    mean_s: float
    accuracy: float


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """The stored figures. never_met: of the third study's pad, with a network of fabric pads alone.

    fixed: see `at_fixed_times`.
    """

    studies: dict[str, StudyFigures]
    never_met: tuple[AtFinal, ...]
    challenge: tuple[AtLimit, ...]
    fixed: dict[int, float]

    @property
    def default(self) -> Point:
        """The point with the default settings, on HAART."""
        settings = DecisionSettings()
        pair = settings.speak_above, REVISE_MARGIN
        return next(p for p in self.studies[HELD_OUT].curve if (p.speak_above, p.revise_margin) == pair)


def main(arguments: Sequence[str]) -> int:
    """Measure, store the figures, fill the page and draw; returns 0."""
    options = study_parser("decision", __doc__, *STUDIES, "docs", "weights").parse_args(arguments)
    folders, weights = folders_of(options), options.weights
    people = never_seen(folders, weights)
    # More of the second study than is scored elsewhere: every take.
    people[SECOND] = left_out_split(weights, folders.to_train_on(("second",)))
    third = [recording for _, own in people[THIRD] for recording in own]
    fabric = Classifier.load(weights / FABRIC_MODEL.name)
    ((shipped, test),) = people[TEST]
    measured = measure(
        {name: collect(own, name, MISSING["third"] if name == THIRD else ()) for name, own in people.items()},
        collect([(fabric, third)], NEVER_MET, MISSING["third"]),
        windows_of(haart.cut(test, FRAMES), shipped),
        at_fixed_times(people[TEST]),
    )
    keep(FILE, measured)
    fill(options.docs / "decision.md", tables(measured))
    draw(measured, options.docs / "figures" / "decision.png")
    return 0


def measure(
    studies: Mapping[str, Streams], never_met: Streams, windows: Streams, fixed: Mapping[int, float]
) -> Measured:
    """Return the figures of the studies' touches and of the challenge's test windows.

    fixed: see `at_fixed_times`.
    """
    return Measured(
        studies={title: figures_of(streams) for title, streams in studies.items()},
        never_met=tuple(at_final(never_met, limit) for limit in FINAL),
        challenge=tuple(at_limit(windows, limit) for limit in LIMITS),
        fixed=dict(fixed),
    )


def at_fixed_times(split: Split) -> dict[int, float]:
    """Return the accuracy by frames, each on windows of that length, as in the paper's and our tables."""
    return {frames: score(split, frames).accuracy for frames in TABLE3 if frames <= FRAMES}


def figures_of(streams: Streams) -> StudyFigures:
    """Return one study's figures."""
    settings = (DecisionSettings(), DecisionSettings(early="when_sure"))
    return StudyFigures(
        people=len(set(streams.participants)),
        touches=len(streams.truth),
        stages=tuple(stage_figures(streams, *each) for each in zip(STAGES, MARKS, strict=True)),
        curve=tuple(point(streams, *pair) for pair in product(SPEAK_ABOVE, MARGINS)),
        final=tuple(at_final(streams, limit) for limit in FINAL),
        choices=tuple(choice(streams, each) for each in settings),
    )


def stage_figures(streams: Streams, stage: Stage, frames: int) -> StageFigures:
    """Return accuracy and calibration error of the network's answers after this number of frames."""
    outputs = streams.probabilities[:, frames - 1].astype(np.float64)
    return StageFigures(
        stage=stage,
        accuracy=float((outputs.argmax(axis=1) == streams.truth).mean()),
        calibration_error=metrics.expected_calibration_error(outputs, streams.truth),
    )


def point(streams: Streams, speak_above: float, revise_margin: float) -> Point:
    """Return what the robot would be told under one pair of settings."""
    told = tell(streams, DecisionSettings(speak_above=speak_above), revise_margin)
    early = [t.right[0] for t in told if t.answers and t.answers[0][0] == "early"]
    return Point(
        speak_above=speak_above,
        revise_margin=revise_margin,
        told_early=len(early) / len(told),
        right_when_told_early=float(np.mean(early)) if early else 1.0,
        right_at_end=float(np.mean([t.settled for t in told])),
        changed=float(np.mean([len(t.right) > 1 for t in told])),
        harmed=float(np.mean([t.harmed for t in told])),
    )


def at_final(streams: Streams, final_above: float) -> AtFinal:
    """Return what one `final_above` names."""
    told = tell(streams, DecisionSettings(final_above=final_above))
    right, named = sum(each.settled for each in told), sum(bool(each.answers) for each in told)
    return AtFinal(
        final_above=final_above,
        right=round(100 * right / len(told), 1),
        right_of_named=round(100 * right / max(1, named), 1),
    )


def choice(streams: Streams, settings: DecisionSettings) -> Choice:
    """Return what one choice of `scene.early` costs."""
    told = tell(streams, settings)
    first_s = [t.answers[0][1] for t in told if t.answers]
    return Choice(
        early=settings.early,
        first_mean_s=float(np.mean(first_s)),
        first_right=float(np.mean([t.right[0] for t in told if t.answers])),
        right=float(np.mean([t.settled for t in told])),
        harmed=float(np.mean([t.harmed for t in told])),
    )


def tell(streams: Streams, settings: DecisionSettings, revise_margin: float = REVISE_MARGIN) -> list[Told]:
    """Return what the daemon's decision would tell the robot of each touch."""
    told = []
    for outputs, truth, detected in zip(streams.probabilities, streams.truth, streams.detected, strict=True):
        decision = Decision(settings, streams.labels, revise_margin)
        due = dict(zip(settings.answer_at_frames, STAGES, strict=True))
        answers = []
        asked = range(1, FRAMES + 1) if decision.may_be_early else settings.answer_at_frames
        for frames in (n for n in asked if n > detected):
            probabilities = outputs[frames - 1].astype(np.float64)
            stage = due.get(frames)
            may = decision.may_be_early and "early" in due.values()
            if may and decision.is_sure(probabilities, frames):
                stage = "early"
            if stage is None:
                continue
            due = {length: name for length, name in due.items() if name != stage}
            answer = decision.answer(stage, probabilities)
            if answer.told and answer.gesture != UNCERTAIN:
                answers.append((stage, frames / FRAME_RATE_HZ, answer.gesture == streams.labels[truth]))
        told.append(Told(tuple(answers)))
    return told


def at_limit(windows: Streams, limit: float) -> AtLimit:
    """Return how windows are answered once the confidence reaches the daemon's limit."""
    limits = np.array([sure_above(limit, frames) for frames in range(1, FRAMES + 1)])
    sure = windows.probabilities.max(axis=2) >= limits
    sure[:, : EARLIEST_FRAMES - 1] = False
    sure[:, -1] = True
    frames = sure.argmax(axis=1) + 1
    return AtLimit(
        limit=limit,
        mean_s=float(frames.mean()) / FRAME_RATE_HZ,
        accuracy=_accuracy(windows, frames),
    )


def _accuracy(windows: Streams, frames: NDArray[np.int64]) -> float:
    """Return the macro accuracy of windows answered after these numbers of frames (N,)."""
    outputs = windows.probabilities[np.arange(len(frames)), frames - 1]
    return metrics.macro_accuracy(outputs.argmax(axis=1), windows.truth, len(windows.labels))


def collect(split: Split, title: str, missing: Sequence[str] = ()) -> Streams:
    """Return each network's answers about the touches of its recordings, frame by frame.

    missing: gestures that the study does not contain and that are not allowed as answers.
    """
    cases = [(model, case) for model, recordings in split for case in spliced(recordings, level_rest=True)]
    labels = split[0][0].labels
    console = Console(stderr=True)
    rows = [
        (outputs, labels.index(case.gesture), detected, case.participant)
        for model, case in track(
            cases, title, console=console, transient=True, disable=not console.is_terminal
        )
        for detected, outputs in _follow(case, model)
    ]
    answers, truth, detected_at, people = zip(*rows, strict=True)
    outputs = np.stack(answers)
    if missing:
        outputs[:, :, [labels.index(gesture) for gesture in missing]] = 0.0
        outputs /= outputs.sum(axis=2, keepdims=True)
    return Streams(outputs, np.array(truth), np.array(detected_at), np.array(people), labels)


def windows_of(windows: haart.Windows, model: Classifier) -> Streams:
    """Return a network's answers about windows of FRAMES frames, frame by frame, "notouch" included."""
    outputs = np.zeros((len(windows.labels), FRAMES, len(model.labels)), np.float32)
    for answers, window in zip(outputs, windows.counts, strict=True):
        state: ModelState | None = None
        for frame in range(FRAMES):
            answers[frame], state = model.step(window[frame : frame + 1], state)
    detected = np.zeros(len(windows.labels), np.int64)
    return Streams(outputs, windows.labels, detected, windows.participants, model.labels)


def _follow(case: Case, model: Classifier) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Yield the frame at which the case's touch was detected and the answers; nothing for a short touch."""
    scans = case.scans[LEAD_FRAMES - REST_FRAMES : case.stop]
    found = first_touch(scans, detector_for(model))
    if found is None or found[1] < REST_FRAMES or found[0] + FRAMES > len(scans):
        return
    first, detected = found
    state, outputs = None, []
    for scan in scans[first : first + FRAMES]:
        answer, state = model.step(np.clip(np.rint(scan), 0, MAX_COUNT)[None], state)
        outputs.append(answer)
    yield detected - first, np.array(outputs, np.float32)


def tables(measured: Measured) -> dict[str, str]:
    """Return the page's tables, in percent and seconds."""
    default, curve = measured.default, measured.studies[HELD_OUT].curve
    final = {title: study.final for title, study in measured.studies.items()} | {
        NEVER_MET: measured.never_met
    }
    return {
        "final": table(
            ("`final_above`", *final),
            [
                (
                    f"{limit:.2f}" + (" (default)" if limit == FINAL_ABOVE else ""),
                    *(f"{points[row].right:g} / {points[row].right_of_named:g}" for points in final.values()),
                )
                for row, limit in enumerate(FINAL)
                if limit in FINAL_SHOWN
            ],
        ),
        "curve": table(
            ("`speak_above`", "told early", "then right", "right at the end", "harmed"),
            [
                (
                    f"{p.speak_above:.2f}" + (" (default)" if p == default else ""),
                    *map(percent, (p.told_early, p.right_when_told_early, p.right_at_end, p.harmed)),
                )
                for p in curve
                if p.revise_margin == default.revise_margin and (p == default or p.speak_above in SHOWN)
            ],
        ),
    }


def draw(measured: Measured, path: Path) -> None:
    """Draw accuracy over time on the challenge's windows, and how often early answers come and are right."""
    figure = Figure(figsize=(10.4, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_over_time(measured, left)
    _draw_early(measured, right)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _draw_over_time(measured: Measured, left: Axes) -> None:
    lines = {
        "touchd, once it is sure": ("#1f5fa8", [(e.mean_s, 100 * e.accuracy) for e in measured.challenge]),
        "touchd, fixed time": ("#5b9bd5", [(n / FRAME_RATE_HZ, 100 * a) for n, a in measured.fixed.items()]),
        "the paper, fixed time": ("#c4611a", [(n / FRAME_RATE_HZ, TABLE3[n]) for n in measured.fixed]),
    }
    for place, (title, (colour, points)) in enumerate(lines.items()):
        left.plot(*zip(*points, strict=True), "o-", color=colour, markersize=4)
        left.annotate(title, LABELS_AT[place], color=colour)
    left.set(xlabel="mean time to the answer, s", ylabel="macro accuracy on the test participants, %")
    left.set(xlim=(0, 2.8), ylim=(55, 92))


def _draw_early(measured: Measured, right: Axes) -> None:
    margin = measured.default.revise_margin
    for colour, (title, study) in zip(
        ("#1f5fa8", "#2a8a57", "#7a3f98", "#c4611a"), measured.studies.items(), strict=False
    ):
        along = [p for p in study.curve if p.revise_margin == margin]
        points = [(100 * p.told_early, 100 * p.right_when_told_early) for p in along]
        right.plot(*zip(*points, strict=True), "o-", color=colour, markersize=4)
        va = "top" if title in (HELD_OUT, THIRD) else "bottom"
        right.annotate(title, points[0], xytext=(6, 0), textcoords="offset points", va=va, color=colour)
        chosen = next(p for p in along if p.speak_above == measured.default.speak_above)
        right.plot(
            100 * chosen.told_early, 100 * chosen.right_when_told_early, "*", color=colour, markersize=14
        )
    curve = measured.studies[HELD_OUT].curve
    for p in [p for p in curve if p.revise_margin == margin and p.speak_above in NAMED]:
        dot = (100 * p.told_early, 100 * p.right_when_told_early)
        name = f"{p.speak_above:.2g}"
        right.annotate(name, dot, xytext=(4, 3), textcoords="offset points", color="#1f5fa8", fontsize=8)
    right.set(xlabel="touches told after 1 s, %", ylabel="right when told, %", xlim=(0, 140))
    right.set_xticks(range(0, 101, 20))
