"""Accuracy on held-out recordings before and after adapting, with confidence intervals.

With two or more participants, participants are held out; with one, recordings. Windows of a recording are
never on both sides. A held-out recording is evaluated only if the fold trains on its gesture.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from touchd.drivers.recording import Recording

LeftOut = Literal["participants", "recordings", "nothing"]
Floats = NDArray[np.float64]
MOST_PARTICIPANT_FOLDS = 20
MOST_RECORDING_FOLDS = 4
# Two-sided 95 %.
UPPER = 0.975


class Fold(NamedTuple):
    """Indices of the recordings to train on, and of those held out and evaluated."""

    trained: list[int]
    evaluated: list[int]


def plan(recordings: Sequence[Recording]) -> tuple[LeftOut, list[Fold]]:
    """Return what is held out, and the folds; none if there are too few recordings to hold any out."""
    people = sorted({recording.participant for recording in recordings})
    left_out: LeftOut = "participants" if len(people) > 1 else "recordings"
    fold_of = [people.index(recording.participant) % MOST_PARTICIPANT_FOLDS for recording in recordings]
    if left_out == "recordings":
        # Distribute the recordings of each gesture over the folds.
        earlier = Counter[str]()
        for place, recording in enumerate(recordings):
            fold_of[place] = earlier[recording.gesture] % MOST_RECORDING_FOLDS
            earlier[recording.gesture] += 1
    folds = []
    for fold in sorted(set(fold_of)):
        trained = [i for i, own in enumerate(fold_of) if own != fold]
        gestures = {recordings[i].gesture for i in trained}
        held_out = [i for i, own in enumerate(fold_of) if own == fold and recordings[i].gesture in gestures]
        # With one label, accuracy is trivially 100 %.
        if held_out and len(gestures) > 1:
            folds.append(Fold(trained, held_out))
    return left_out if folds else "nothing", folds


@dataclass(frozen=True)
class Scored:
    """A held-out recording, and the shares of its windows answered rightly before and after adapting."""

    participant: str
    gesture: str
    before: float
    after: float


class GestureFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Accuracy for one gesture on held-out windows. before: None if the shipped model lacks the gesture."""

    recordings: int
    before: float | None
    after: float


class LengthFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Accuracy on all held-out windows of one length.

    frames: the length; IN_PASSING for ended touches in passing, of whatever length. before, after: macro
    accuracy over gestures that the shipped model has, None without any; if participants are held out, the
    mean over them. interval: of the difference, 95 %, None if there is too little data.
    """

    frames: int
    gestures: dict[str, GestureFigures]
    before: float | None = None
    after: float | None = None
    interval: tuple[float, float] | None = None


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """Held-out accuracy before and after; touches in passing first, then by length."""

    left_out: LeftOut
    participants: int
    lengths: list[LengthFigures]


def compare(scored: Mapping[int, Sequence[Scored]], known: Sequence[str], left_out: LeftOut) -> Comparison:
    """Return the figures of held-out recordings by the length of the windows. known: the shipped labels."""
    return Comparison(
        left_out=left_out,
        participants=len({each.participant for own in scored.values() for each in own}),
        lengths=[_figures(frames, own, known, left_out) for frames, own in scored.items() if own],
    )


def _figures(frames: int, scored: Sequence[Scored], known: Sequence[str], left_out: LeftOut) -> LengthFigures:
    gestures = {}
    for name, own in _by(scored, "gesture").items():
        before, after = _macro(own).tolist()
        was = before if name in known else None
        gestures[name] = GestureFigures(recordings=len(own), before=was, after=after)
    in_both = [each for each in scored if each.gesture in known]
    if not in_both:
        return LengthFigures(frames=frames, gestures=gestures)
    if left_out == "participants":
        shares = np.array([_macro(own) for own in _by(in_both, "participant").values()])
        before, after = shares.mean(axis=0).tolist()
    else:
        shares = np.array([(each.before, each.after) for each in in_both])
        before, after = _macro(in_both).tolist()
    interval = mean_interval(shares[:, 1] - shares[:, 0])
    return LengthFigures(frames=frames, gestures=gestures, before=before, after=after, interval=interval)


def _by(scored: Sequence[Scored], key: Literal["gesture", "participant"]) -> dict[str, list[Scored]]:
    """Return the recordings of each gesture or participant, sorted by its name."""
    names = sorted({getattr(each, key) for each in scored})
    return {name: [each for each in scored if getattr(each, key) == name] for name in names}


def _macro(scored: Sequence[Scored]) -> Floats:
    """Return the means over gestures (2,) of the recordings' shares before and after."""
    by_gesture = _by(scored, "gesture").values()
    means = [np.mean([(each.before, each.after) for each in own], axis=0) for own in by_gesture]
    return np.asarray(np.mean(means, axis=0))


def mean_interval(values: Floats) -> tuple[float, float] | None:
    """Return the 95 % t interval of a mean; None if it cannot be estimated.

    Unlike a bootstrap, it is wide enough with two or three values.
    """
    # A few equal changes do not prove that everybody changes equally.
    if len(values) < 2 or np.ptp(values) < 1e-9:
        return None
    middle = float(values.mean())
    reach = float(stdtrit(len(values) - 1, UPPER) * values.std(ddof=1) / math.sqrt(len(values)))
    return middle - reach, middle + reach
