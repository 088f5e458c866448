"""Touches in passing, played through the daemon's pipeline: `python -m touchd.model.studies passing`.

People touch a robot for a second: one stroke, a pat, three pats, a moment of rubbing. Such touches are cut
from the studies' recordings: whole contacts of pats and strokes, and pieces of the other gestures of half a
second to two seconds, which begin and end within a few frames. Each is followed by three seconds of the same
person's and condition's rest, shifted as in the sessions. Networks never saw the person.

The second study's takes neither begin nor end with the hand's coming and going (pressure in their first and
last half second is as high as in the middle), so its touches are cut like HAART's.
"""

import random
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.daemon.path.decide import FINAL_ABOVE
from touchd.daemon.path.events import UNCERTAIN, Event, Prediction, epoch_s
from touchd.drivers.frame import FRAME_RATE_HZ, MAX_COUNT, NO_TOUCH, Counts
from touchd.drivers.recording import Recording, setup_of
from touchd.model.classifier import Classifier
from touchd.model.studies.folders import STUDIES, TEST, THIRD, folders_of, never_seen, study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.studies.play import frames_of, play
from touchd.model.studies.results import STORED, keep
from touchd.model.studies.sessions import changes
from touchd.model.studies.sessions.changes import ChangeScore
from touchd.model.studies.sessions.score import FRAME_MS, Detected, detected_in
from touchd.model.training.contacts import LEAVES, contacts, lightest, shift_of_rest
from touchd.model.training.studies import study_of

FILE = STORED / "passing.json"
LIMITS = (0.3, FINAL_ABOVE, 0.5)
REST_FRAMES = 162
# A cut piece rises from rest, and falls to it, within this many frames.
FADE_FRAMES = 4
PIECES_S = (0.5, 1.0, 2.0)
THREE = 3
# A detected touch belongs to a touch made that it overlaps, or from which it is at most this far.
BESIDE_MS = 150.0
ONE, SEVERAL = "one", "three"
MIXED = ((ONE, "stroke"), (ONE, "pat"), (SEVERAL, "pat"), ("1 s", ""))
"""What a visitor does: these kinds make up the figure of all touches; "": any gesture."""
SHOWN = (
    "constant, 1 s",
    "pat, one",
    "pat, three",
    "rub, 1 s",
    "scratch, 1 s",
    "stroke, one",
    "tickle, 1 s",
)
"""The touches that have a row of their own on the page."""


@dataclass(frozen=True, eq=False)
class PassingTouch:
    """A touch within a session: frames start <= i < stop. kind: "one", "three" contacts or "1 s"."""

    gesture: str
    kind: str
    start: int
    stop: int

    @property
    def is_in_mix(self) -> bool:
        return any(self.kind == kind and gesture in ("", self.gesture) for kind, gesture in MIXED)


@dataclass(frozen=True, eq=False)
class PassingSession:
    """The pad's counts (T, 8, 8) while one person under one condition touches it now and then."""

    participant: str
    counts: Counts
    touches: tuple[PassingTouch, ...]


@dataclass(frozen=True)
class Outcome:
    """The outcome of one touch. told: gestures told, in order. answered_s: from lift-off to the first answer.

    perhaps: the likeliest gesture of an `uncertain` answer, else "". ended: the likeliest gesture and its
    confidence when the touch ended; None if it had its final answer before.
    """

    touch: PassingTouch
    detected: int
    told: tuple[str, ...]
    answered_s: float | None
    perhaps: str
    ended: tuple[str, float] | None


class PassingScore(msgspec.Struct, frozen=True, kw_only=True):
    """Percent of touches, unless stated otherwise.

    right: named rightly by the last answer. right_of_named: the same, of the touches that were named.
    missed: not detected. several: detected as more than one. harmful: told right, then wrong. perhaps: named
    rightly by the last answer, or by its likeliest gesture if it is `uncertain`.
    answered_s: mean seconds from lift-off to the first answer, of touches answered after it. n: touches.
    """

    right: float
    right_of_named: float
    missed: float
    several: float
    harmful: float
    perhaps: float
    answered_s: float
    n: int


def sessions(recordings: Sequence[Recording]) -> Iterator[PassingSession]:
    """Yield a session for each person and condition with a recording at rest."""
    rng = random.Random(7)
    conditions: dict[tuple[str, str, str], list[Recording]] = {}
    for recording in recordings:
        conditions.setdefault(setup_of(recording), []).append(recording)
    for (participant, _, _), own in sorted(conditions.items()):
        resting = [recording for recording in own if recording.gesture == NO_TOUCH]
        if not resting:
            continue
        rest = _rest_frames(resting[0])
        parts: list[tuple[PassingTouch | None, NDArray[np.float32]]] = [(None, rest)]
        touches = [
            (touch.gesture, kind, frames, rest + _shift(touch, resting[0]))
            for touch in own
            if touch.gesture != NO_TOUCH
            for kind, frames in _cut(touch, resting[0], rng)
        ]
        rng.shuffle(touches)
        at = len(rest)
        for gesture, kind, frames, after in touches:
            parts.append((PassingTouch(gesture, kind, at, at + len(frames)), frames))
            parts.append((None, after))
            at += len(frames) + len(after)
        counts = np.concatenate([frames for _, frames in parts])
        yield PassingSession(
            participant,
            np.clip(np.rint(counts), 0, MAX_COUNT).astype(np.uint16),
            tuple(touch for touch, _ in parts if touch is not None),
        )


def _rest_frames(resting: Recording) -> NDArray[np.float32]:
    counts = resting.counts[len(resting.counts) // 4 :]
    return np.asarray(counts[:REST_FRAMES], np.float32)


def _shift(touch: Recording, resting: Recording) -> NDArray[np.float32]:
    """Return (8, 8) counts by which rest is shifted after a touch whose hand leaves the pad."""
    leaves = touch.gesture in (*LEAVES, "tickle")
    return shift_of_rest(touch.counts, resting.counts) if leaves else np.zeros((8, 8), np.float32)


def _cut(
    touch: Recording, resting: Recording, rng: random.Random
) -> Iterator[tuple[str, NDArray[np.float32]]]:
    """Yield the kinds of touches in passing that a recording gives, with their frames."""
    counts = np.asarray(touch.counts, np.float32)
    if touch.gesture in LEAVES:
        found = contacts(touch, is_soft=study_of(touch.participant) == "third")
        if found:
            first, stop = rng.choice(found)
            yield ONE, counts[first:stop]
        if touch.gesture == "pat" and len(found) >= THREE:
            begun = rng.randrange(len(found) - THREE + 1)
            yield SEVERAL, counts[found[begun][0] : found[begun + THREE - 1][1]]
        return
    rest = lightest(resting.counts)
    for seconds in PIECES_S:
        frames = round(seconds * FRAME_RATE_HZ)
        start = rng.randrange(max(1, len(counts) - frames))
        ticks = np.arange(frames)
        contact = np.clip(np.minimum(ticks + 1, frames - ticks) / FADE_FRAMES, 0.0, 1.0)[:, None, None]
        yield f"{seconds:g} s", rest + (counts[start : start + frames] - rest) * contact.astype(np.float32)


def judge(session: PassingSession, events: Iterable[Event]) -> list[Outcome]:
    """Compare the daemon's answers with the touches made."""
    found = detected_in(events)
    return [_outcome(touch, [each for each in found if _belongs(each, touch)]) for touch in session.touches]


def _belongs(detected: Detected, touch: PassingTouch) -> bool:
    start_ms, stop_ms = touch.start * FRAME_MS, touch.stop * FRAME_MS
    return detected.start_ms < stop_ms + BESIDE_MS and detected.stop_ms > start_ms - BESIDE_MS


def _outcome(touch: PassingTouch, detected: Sequence[Detected]) -> Outcome:
    answers = [answer for each in detected for answer in each.answers]
    told = [answer for answer in answers if answer.told and answer.gesture != UNCERTAIN]
    over_s = touch.stop * FRAME_MS / 1000.0
    last = answers[-1] if answers else None
    return Outcome(
        touch,
        len(detected),
        tuple(answer.gesture for answer in told),
        epoch_s(told[0].time) - over_s if told else None,
        last.perhaps if last is not None else "",
        _likeliest(last) if last is not None and last.stage in ("released", "uncertain") else None,
    )


def _likeliest(answer: Prediction) -> tuple[str, float]:
    name = max(answer.probabilities, key=lambda name: answer.probabilities[name])
    return name, answer.probabilities[name]


def score(outcomes: Sequence[Outcome]) -> PassingScore:
    """Return the figures of these touches together."""
    named = [outcome for outcome in outcomes if outcome.told]
    right = [outcome for outcome in named if outcome.told[-1] == outcome.touch.gesture]
    waits_s = [
        outcome.answered_s for outcome in named if outcome.answered_s is not None and outcome.answered_s > 0.0
    ]

    def percent(some: int, of: int | None = None) -> float:
        return round(100.0 * some / max(1, len(outcomes) if of is None else of), 1)

    return PassingScore(
        right=percent(len(right)),
        right_of_named=percent(len(right), len(named)),
        missed=percent(sum(not outcome.detected for outcome in outcomes)),
        several=percent(sum(outcome.detected > 1 for outcome in outcomes)),
        harmful=percent(
            sum(
                any(a == outcome.touch.gesture != b for a, b in pairwise(outcome.told))
                for outcome in outcomes
            )
        ),
        perhaps=percent(
            sum(outcome.touch.gesture in (*outcome.told[-1:], outcome.perhaps) for outcome in outcomes)
        ),
        answered_s=round(float(np.mean(waits_s)), 3) if waits_s else 0.0,
        n=len(outcomes),
    )


def measure(recordings: Sequence[Recording], model: Classifier) -> list[Outcome]:
    """Play a session for each person and condition; return the outcome of each touch."""
    return [
        outcome
        for session in sessions(recordings)
        for outcome in judge(session, play(frames_of(session.counts), model, flush=True))
    ]


def rows(outcomes: Sequence[Outcome]) -> dict[str, PassingScore]:
    """Return the scores of the visitor's mix, and of each gesture and kind."""
    groups: dict[str, list[Outcome]] = {
        "mix": [outcome for outcome in outcomes if outcome.touch.is_in_mix],
        "all": [*outcomes],
    }
    for outcome in sorted(outcomes, key=lambda outcome: (outcome.touch.gesture, outcome.touch.kind)):
        groups.setdefault(f"{outcome.touch.gesture}, {outcome.touch.kind}", []).append(outcome)
    return {name: score(own) for name, own in groups.items() if own}


def curve(outcomes: Sequence[Outcome], limits: Sequence[float]) -> list[tuple[float, float, float]]:
    """Return for each value of `final_above`: it, percent right of all, percent right of the named."""
    rows = []
    for limit in limits:
        named = [
            outcome.ended[0]
            if outcome.ended is not None and outcome.ended[1] >= limit and outcome.ended[0] != NO_TOUCH
            else next(iter(outcome.told[-1:]), None)
            if outcome.ended is None
            else None
            for outcome in outcomes
        ]
        right = sum(name == outcome.touch.gesture for name, outcome in zip(named, outcomes, strict=True))
        count = sum(name is not None for name in named)
        rows.append((limit, round(100 * right / len(outcomes), 1), round(100 * right / max(1, count), 1)))
    return rows


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One study's figures: by touch, and the curve of `final_above`."""

    scores: dict[str, PassingScore]
    curve: list[tuple[float, float, float]]


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """The stored figures of touches in passing and of changes, with the model's name."""

    model: str
    passing: dict[str, Row]
    changes: dict[str, ChangeScore]


def row_of(outcomes: Sequence[Outcome]) -> Row:
    """Return one study's figures."""
    mix = [outcome for outcome in outcomes if outcome.touch.is_in_mix]
    return Row(scores=rows(outcomes), curve=curve(mix, LIMITS))


def tables(measured: Measured) -> dict[str, str]:
    """Return the tables of docs/sessions.md by their places."""
    people = list(measured.passing)

    def of_mix(value: Callable[[PassingScore], float]) -> list[str]:
        return [f"{value(measured.passing[each].scores['mix']):g}" for each in people]

    def right(name: str) -> list[str]:
        found = [measured.passing[each].scores.get(name) for each in people]
        return [f"{one.right:g}" if one else "" for one in found]

    rows = [
        ("touches", of_mix(lambda score: score.n)),
        ("**right of all**", of_mix(lambda score: score.right)),
        ("right of those that were named", of_mix(lambda score: score.right_of_named)),
        ("missed", of_mix(lambda score: score.missed)),
        ("from lift-off to the first answer, s", of_mix(lambda score: score.answered_s)),
        *((name, right(name)) for name in SHOWN),
    ]
    changed = [(name, one.both, one.last, one.third, one.after_s) for name, one in measured.changes.items()]
    headings = ("people", "both told", "last right", "a third told", "told after, s")
    return {
        "passing": table(("", *people), [(name, *row) for name, row in rows]),
        "changes": table(headings, changed),
    }


def curve_table(measured: Measured) -> dict[str, str]:
    """Return the table of docs/decision.md by its place."""
    people = list(measured.passing)
    limits = [
        (f"{limit:.2f}" + (" (default)" if limit == FINAL_ABOVE else ""))
        for limit, _, _ in measured.passing[people[0]].curve
    ]
    columns = [
        [f"{right:g} / {named:g}" for _, right, named in measured.passing[each].curve] for each in people
    ]
    return {"released": table(("`final_above`", *people), zip(limits, *columns, strict=True))}


def main(arguments: Sequence[str]) -> int:
    """Measure touches in passing and changes, store the figures and fill the pages; returns 0."""
    what = "Plays touches of a second or less, and hands that change their gesture."
    options = study_parser("passing", what, *STUDIES, "docs", "weights").parse_args(arguments)
    passing: dict[str, Row] = {}
    changed: dict[str, ChangeScore] = {}
    people = never_seen(folders_of(options), options.weights)
    for name, split in people.items():
        passing[name] = row_of([outcome for model, own in split for outcome in measure(own, model)])
        if name != THIRD:
            changed[name] = changes.measure(split)
        sys.stderr.write(f"{name}: {msgspec.json.encode(passing[name].scores['mix']).decode()}\n")
    ((shipped, _),) = people[TEST]
    measured = Measured(model=shipped.name, passing=passing, changes=changed)
    keep(FILE, measured)
    fill(options.docs / "sessions.md", tables(measured))
    fill(options.docs / "decision.md", curve_table(measured))
    return 0
