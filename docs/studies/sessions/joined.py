"""Two gestures without a pause between them, and single ones of 7 s, through the daemon's own pipeline.

`python -m docs.studies joined FILE... [--people P3,P4] [--substrate static] [--cover none]
[--model FOLD.onnx]` prints a line a file.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from daemon.events import UNCERTAIN
from daemon.pipeline import PipelineSettings
from docs.studies.sessions.plan import SKIPPED_FRAMES, PlannedSession, Scans
from docs.studies.sessions.report import add_choice, print_scores
from docs.studies.sessions.score import felt_in, play
from drivers.frame import FRAME_RATE_HZ
from drivers.recording import NO_TOUCH, Recording, set_up
from model.classifier import Classifier

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

    def began_right(one: Made) -> bool:
        before = [gesture for at_s, _, gesture in one.told if at_s <= change_s + CLOSE_S]
        return before[-1:] == [one.gesture]

    def was_told(one: Made) -> bool:
        until_s = change_s + TOLD_WITHIN_S + CLOSE_S
        return any(change_s < at_s <= until_s and gesture == one.then for at_s, _, gesture in one.told)

    def was_wrong(one: Made) -> bool:
        later = [gesture for at_s, _, gesture in one.told if at_s > change_s + CLOSE_S]
        return any(gesture not in (one.then, UNCERTAIN) for gesture in later)

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
    together: dict[tuple[str, str, str], dict[str, Scans]] = {}
    for recording in recordings:
        together.setdefault(set_up(recording), {}).setdefault(recording.gesture, recording.counts)
    for _, counts in sorted(together.items()):
        quiet = counts.pop(NO_TOUCH, None)
        if quiet is None:
            continue
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
    counts = np.concatenate([before, *parts, after])
    events = play(PlannedSession("", "", "", counts, ()), model, PipelineSettings())
    return tuple(
        (touch.start_ms / 1000.0 + answer.elapsed_s, answer.stage, answer.gesture)
        for touch in felt_in(events)
        for answer in touch.answers
        if answer.told
    )


def main(arguments: Sequence[str]) -> int:
    """Print the scores; returns 0."""
    parser = argparse.ArgumentParser(prog="python -m docs.studies joined")
    add_choice(parser)
    print_scores(parser.parse_args(arguments), measure)
    return 0
