"""Scores a session touch by touch: which were detected, and what the robot was told."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf

import msgspec
import numpy as np

from touchd.daemon.path.events import Event, Prediction, TouchBegan, TouchEnded, epoch_s
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.model.studies.sessions.plan import PlannedSession, Stretch

# A detected touch belongs to a stretch that it overlaps by more than this.
OVERLAP_MS = 100.0
OPEN_MS = 2000.0
FRAME_MS = 1000.0 / FRAME_RATE_HZ


class SessionScore(msgspec.Struct, frozen=True, kw_only=True):
    """Percent of the touches made, unless stated otherwise.

    missed: not detected. merged: detected as one with another. split: detected as several.
    early, revised, final: right at that stage. last, first: right in the last, first answer told.
    harmful: told right, then wrong. open: not ended 2 s after the hand left.
    false: touches in ten minutes of quiet.
    t_first: mean seconds until the first answer told. n: touches made.
    """

    missed: float
    merged: float
    split: float
    early: float
    revised: float
    final: float
    last: float
    first: float
    harmful: float
    open: float
    false: float
    t_first: float
    n: int


@dataclass(frozen=True)
class Detected:
    """A touch as detected. over_ms: when its end was reported; infinite if it never was."""

    start_ms: float
    stop_ms: float
    over_ms: float
    answers: tuple[Prediction, ...]


@dataclass(frozen=True)
class Outcome:
    """The outcome of one touch made. answers: of the detected touch, if no earlier touch is merged into it.

    open: whether the detected touch had not ended OPEN_MS after the hand left.
    """

    gesture: str
    missed: bool = False
    merged: bool = False
    split: bool = False
    open: bool = False
    answers: tuple[Prediction, ...] = ()

    @property
    def told(self) -> list[str]:
        """The gestures told to the robot, in order."""
        return [answer.gesture for answer in self.answers if answer.told]

    @property
    def first_s(self) -> float:
        """When the first answer was told, in seconds of the touch."""
        return next(answer.elapsed_s for answer in self.answers if answer.told)

    def is_right_at(self, stage: str) -> bool:
        """Whether an answer at this stage names the gesture."""
        return any(answer.stage == stage and answer.gesture == self.gesture for answer in self.answers)


@dataclass(frozen=True)
class Played:
    """One session's touches, its quiet time, and the touches detected in that time."""

    outcomes: tuple[Outcome, ...]
    quiet_min: float
    false: int


def judge(session: PlannedSession, events: Iterable[Event]) -> Played:
    """Compare the daemon's answers with the touches made."""
    detected = detected_in(events)
    made = [stretch for stretch in session.stretches if stretch.gesture is not None]
    inside = [[i for i, stretch in enumerate(made) if _overlaps(touch, stretch)] for touch in detected]
    quiet = sum(stretch.stop - stretch.start for stretch in session.stretches if stretch.gesture is None)
    return Played(
        tuple(_outcome(i, stretch, detected, inside) for i, stretch in enumerate(made)),
        quiet / FRAME_RATE_HZ / 60.0,
        sum(not among for among in inside),
    )


def score(played: Sequence[Played]) -> SessionScore:
    """Return the figures of these sessions together."""
    outcomes = [outcome for one in played for outcome in one.outcomes]

    def percent(is_so: Callable[[Outcome], bool]) -> float:
        return round(100.0 * sum(map(is_so, outcomes)) / len(outcomes), 1)

    first_s = [outcome.first_s for outcome in outcomes if outcome.told]
    return SessionScore(
        missed=percent(lambda outcome: outcome.missed),
        merged=percent(lambda outcome: outcome.merged),
        split=percent(lambda outcome: outcome.split),
        open=percent(lambda outcome: outcome.open),
        early=percent(lambda outcome: outcome.is_right_at("early")),
        revised=percent(lambda outcome: outcome.is_right_at("revised")),
        final=percent(lambda outcome: outcome.is_right_at("final")),
        last=percent(lambda outcome: outcome.told[-1:] == [outcome.gesture]),
        first=percent(lambda outcome: outcome.told[:1] == [outcome.gesture]),
        harmful=percent(lambda outcome: any(a == outcome.gesture != b for a, b in pairwise(outcome.told))),
        false=round(10.0 * sum(one.false for one in played) / sum(one.quiet_min for one in played), 2),
        t_first=round(float(np.mean(first_s)), 3) if first_s else 99.0,
        n=len(outcomes),
    )


def detected_in(events: Iterable[Event]) -> list[Detected]:
    """Return the touches as detected."""
    answers: dict[int, list[Prediction]] = defaultdict(list)
    began: dict[int, float] = {}
    ended: dict[int, tuple[float, float]] = defaultdict(lambda: (inf, inf))
    for event in events:
        match event:
            case TouchBegan():
                began[event.touch] = event.sensor_ms
            case TouchEnded():
                stop_ms = inf if event.sensor_ms is None else event.sensor_ms
                ended[event.touch] = (stop_ms, epoch_s(event.time) * 1000.0)
            case Prediction():
                answers[event.touch].append(event)
    return [Detected(start_ms, *ended[touch], tuple(answers[touch])) for touch, start_ms in began.items()]


def _overlaps(touch: Detected, stretch: Stretch) -> bool:
    start_ms, stop_ms = stretch.start * FRAME_MS, stretch.stop * FRAME_MS
    return touch.start_ms < stop_ms - OVERLAP_MS and touch.stop_ms > start_ms + OVERLAP_MS


def _outcome(i: int, made: Stretch, detected: Sequence[Detected], inside: Sequence[Sequence[int]]) -> Outcome:
    gesture = made.gesture or ""
    owners = [k for k, among in enumerate(inside) if i in among]
    if not owners:
        return Outcome(gesture, missed=True)
    owner = owners[-1] if len(inside[owners[0]]) > 1 and len(owners) > 1 else owners[0]
    return Outcome(
        gesture=gesture,
        merged=len(inside[owner]) > 1,
        split=sum(len(inside[k]) == 1 for k in owners) > 1,
        open=any(detected[k].over_ms > made.stop * FRAME_MS + OPEN_MS for k in owners),
        answers=detected[owner].answers if inside[owner][0] == i else (),
    )
