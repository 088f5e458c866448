"""Two gestures without a pause between them, and single ones of 7 s, through the daemon's own pipeline.

`python -m touchd.model.studies joined FILE... [--people P3,P4] [--substrate static] [--cover none]
[--model FOLD.onnx]` prints a line a file.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf

import msgspec
import numpy as np

from touchd.daemon.events import UNCERTAIN
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.recording import NO_TOUCH, Recording
from touchd.model.classifier import Classifier
from touchd.model.studies.folders import study_parser
from touchd.model.studies.play import frames_of, play
from touchd.model.studies.sessions.plan import SKIPPED_FRAMES, Scans, together
from touchd.model.studies.sessions.report import add_choice, print_scores
from touchd.model.studies.sessions.score import felt_in

QUIET_BEFORE_FRAMES, QUIET_AFTER_FRAMES = 162, 108
FIRST_FRAMES, SECOND_FRAMES, SINGLE_FRAMES = 189, 162, 378
KNOWN_AFTER_FRAMES = 108
TOLD_WITHIN_S = 2.0
# An answer at the very frame of the change is still about the first gesture.
CLOSE_S = 0.02


class JoinedScore(msgspec.Struct, frozen=True, kw_only=True):
    """Percent.

    joined: touches of two gestures whose first was told rightly before the change. told: of these, the second
    told within two seconds. told_known: the same of those, known, whose second gesture the model names alone
    in two seconds. wrong: told another gesture than the second after the change. single: touches of one
    gesture. again: of these, told again after the final answer.
    """

    joined: int
    told: float
    known: int
    told_known: float
    wrong: float
    single: int
    again: float


@dataclass(frozen=True)
class Made:
    """A touch that was made, and what the robot was told when, seconds from the session's start.

    then: the second gesture, None for a single one. is_known: whether the model names that one alone.
    """

    gesture: str
    then: str | None
    is_known: bool
    told: tuple[tuple[float, str, str], ...]


def measure(recordings: Sequence[Recording], model: Classifier) -> JoinedScore:
    """Play each person's gestures, once followed by another and once alone, and score what was told."""
    made = list(_made(recordings, model))
    change_s = (QUIET_BEFORE_FRAMES + FIRST_FRAMES) / FRAME_RATE_HZ

    def told(one: Made, after_s: float, until_s: float) -> list[str]:
        return [gesture for at_s, _, gesture in one.told if after_s < at_s <= until_s]

    def began_right(one: Made) -> bool:
        return told(one, 0.0, change_s + CLOSE_S)[-1:] == [one.gesture]

    def was_told(one: Made) -> bool:
        return one.then in told(one, change_s, change_s + TOLD_WITHIN_S + CLOSE_S)

    def was_wrong(one: Made) -> bool:
        return not {*told(one, change_s + CLOSE_S, inf)} <= {one.then, UNCERTAIN}

    def percent(true: Sequence[bool]) -> float:
        return round(100.0 * sum(true) / max(1, len(true)), 1)

    joined = [one for one in made if one.then is not None and began_right(one)]
    known = [one for one in joined if one.is_known]
    single = [one for one in made if one.then is None]
    return JoinedScore(
        joined=len(joined),
        told=percent([was_told(one) for one in joined]),
        known=len(known),
        told_known=percent([was_told(one) for one in known]),
        wrong=percent([was_wrong(one) for one in joined]),
        single=len(single),
        again=percent([any(stage == "ongoing" for _, stage, _ in one.told) for one in single]),
    )


def _made(recordings: Sequence[Recording], model: Classifier) -> Iterator[Made]:
    rng = random.Random(1)
    for _, by_gesture in together(recordings):
        quiet, *_ = by_gesture.pop(NO_TOUCH)
        counts = {gesture: first for gesture, (first, *_) in by_gesture.items()}
        for gesture, first in counts.items():
            then = rng.choice([other for other in counts if other != gesture])
            parts = [_part(first, FIRST_FRAMES), _part(counts[then], SECOND_FRAMES)]
            heard = model.probabilities(_part(counts[then], KNOWN_AFTER_FRAMES).astype(np.float32))
            is_known = model.labels[int(heard.argmax())] == then
            yield Made(gesture, then, is_known, _told(quiet, parts, model))
            yield Made(gesture, None, False, _told(quiet, [_part(first, SINGLE_FRAMES)], model))


def _part(counts: Scans, frames: int) -> Scans:
    return counts[SKIPPED_FRAMES : SKIPPED_FRAMES + frames]


def _told(quiet: Scans, parts: Sequence[Scans], model: Classifier) -> tuple[tuple[float, str, str], ...]:
    """Return when, at what stage and with which gesture the robot was told something."""
    before, after = np.split(_part(quiet, QUIET_BEFORE_FRAMES + QUIET_AFTER_FRAMES), [QUIET_BEFORE_FRAMES])
    events = play(frames_of(np.concatenate([before, *parts, after])), model)
    return tuple(
        (touch.start_ms / 1000.0 + answer.elapsed_s, answer.stage, answer.gesture)
        for touch in felt_in(events)
        for answer in touch.answers
        if answer.told
    )


def main(arguments: Sequence[str]) -> int:
    """Print the scores; returns 0."""
    parser = study_parser("joined")
    add_choice(parser)
    print_scores(parser.parse_args(arguments), measure)
    return 0
