"""Hands that change their gesture without leaving the pad; the study `passing` measures them too.

Four seconds of one gesture, then four of another, of one person under one condition; then rest.
"""

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from touchd.daemon.path.events import UNCERTAIN, Event, Prediction, epoch_s
from touchd.drivers.frame import FRAME_RATE_HZ, NO_TOUCH, Counts
from touchd.drivers.recording import Recording
from touchd.model.studies.checks.evaluate import Split
from touchd.model.studies.play import frames_of, play
from touchd.model.studies.sessions.plan import together

REST_FRAMES = 108
EACH_FRAMES = round(4 * FRAME_RATE_HZ)


class ChangeScore(msgspec.Struct, frozen=True, kw_only=True):
    """Percent of pairs, unless stated otherwise.

    both: both gestures were told, in order. last: the last one told was the second. third: a gesture that is
    neither was told. after_s: mean seconds from the change until the second gesture was told. n: pairs.
    """

    both: float
    last: float
    third: float
    after_s: float
    n: int


@dataclass(frozen=True, eq=False)
class Pair:
    """Counts (T, 8, 8): rest, the first gesture, the second, which begins at frame `changes`, rest."""

    first: str
    second: str
    counts: Counts
    changes: int


@dataclass(frozen=True)
class Outcome:
    """What was told of a pair: gestures, and seconds after the change."""

    pair: Pair
    told: tuple[tuple[str, float], ...]

    @property
    def second_after_s(self) -> float | None:
        """Seconds from the change until the second gesture was told, after the first; None if it was not."""
        first = next((i for i, (name, _) in enumerate(self.told) if name == self.pair.first), None)
        if first is None:
            return None
        later = [after_s for name, after_s in self.told[first:] if name == self.pair.second]
        return later[0] if later else None


def pairs(recordings: Sequence[Recording]) -> Iterator[Pair]:
    """Yield each touching recording of a condition followed by another gesture of that condition."""
    rng = random.Random(7)
    for _, by_gesture in together(recordings):
        rest = by_gesture[NO_TOUCH][0]
        touches = [(name, each) for name in sorted(by_gesture) for each in by_gesture[name]]
        touches = [(name, each) for name, each in touches if name != NO_TOUCH and len(each) > EACH_FRAMES]
        for name, counts in touches:
            others = [(other, each) for other, each in touches if other != name]
            if not others:
                continue
            other, following = rng.choice(others)
            first = [rest[:REST_FRAMES], counts[:EACH_FRAMES]]
            parts = [*first, following[-EACH_FRAMES:], rest[-REST_FRAMES:]]
            yield Pair(name, other, np.concatenate(parts).astype(np.uint16), sum(map(len, first)))


def judge(pair: Pair, events: Sequence[Event]) -> Outcome:
    """Return what was told of a pair."""
    told = [event for event in events if isinstance(event, Prediction) and event.told]
    changes_s = pair.changes / FRAME_RATE_HZ
    named = [(event.gesture, epoch_s(event.time) - changes_s) for event in told if event.gesture != UNCERTAIN]
    return Outcome(pair, tuple(named))


def score(outcomes: Sequence[Outcome]) -> ChangeScore:
    """Return the figures of these pairs together."""
    after_s = [outcome.second_after_s for outcome in outcomes]
    known_s = [each for each in after_s if each is not None]

    def percent(some: int) -> float:
        return round(100.0 * some / max(1, len(outcomes)), 1)

    return ChangeScore(
        both=percent(len(known_s)),
        last=percent(
            sum(
                outcome.told[-1:] != () and outcome.told[-1][0] == outcome.pair.second for outcome in outcomes
            )
        ),
        third=percent(
            sum(
                any(name not in (outcome.pair.first, outcome.pair.second) for name, _ in outcome.told)
                for outcome in outcomes
            )
        ),
        after_s=round(float(np.mean(known_s)), 2) if known_s else 0.0,
        n=len(outcomes),
    )


def measure(split: Split) -> ChangeScore:
    """Play every pair with the network that never saw the person, and score them together."""
    return score(
        [
            judge(pair, play(frames_of(pair.counts), model, flush=True))
            for model, recordings in split
            for pair in pairs(recordings)
        ]
    )
