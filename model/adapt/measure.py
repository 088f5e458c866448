"""Accuracy on held-out recordings before and after adapting, with confidence intervals."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax, stdtrit

from touchd.drivers.recording import Recording
from touchd.model.adapt.plan import LeftOut
from touchd.model.settings import LENGTHS

Floats = NDArray[np.float64]
# Two-sided 95 %.
UPPER = 0.975


@dataclass(frozen=True, eq=False)
class Answers:
    """Logits for held-out windows of one length, over the labels of the adapted model.

    recordings: (W,) number of each window's recording. before, after: logits (W, labels); before is -inf for
    gestures that the shipped model does not know.
    """

    recordings: NDArray[np.int64]
    before: Floats
    after: Floats


class GestureFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Accuracy for one gesture on held-out windows of one length.

    before: None if the shipped model lacks the gesture. interval: of `after`, 95 % Wilson; a recording counts
    as one trial.
    """

    recordings: int
    before: float | None
    after: float
    interval: tuple[float, float]


class LengthFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Accuracy on all held-out windows of one length.

    frames: the length; 0 for ended touches in passing, of whatever length.
    before, after: macro accuracy over gestures that the shipped model has, None without any; if participants
    are held out, the mean over them. interval: of the difference, 95 %, None if there is too little data.
    all_after: as after, over all gestures.
    """

    frames: int
    gestures: dict[str, GestureFigures]
    before: float | None
    after: float | None
    interval: tuple[float, float] | None
    all_after: float

    @property
    def difference(self) -> float | None:
        """Gain over the gestures that the shipped model has."""
        return None if self.before is None or self.after is None else self.after - self.before


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """Held-out accuracy before and after.

    left_out: what was held out. in_passing: of ended touches in passing, None if there are none.
    """

    left_out: LeftOut
    participants: int
    lengths: list[LengthFigures]
    in_passing: LengthFigures | None = None


def compare(
    answers: Mapping[int, Answers],
    recordings: Sequence[Recording],
    labels: Sequence[str],
    known: Sequence[str],
    left_out: LeftOut,
    in_passing: Answers | None = None,
) -> Comparison:
    """Return the figures for held-out answers at each length, and to ended touches in passing.

    labels: of the logits. known: those of the shipped model.
    """
    evaluated = {int(i) for length in answers.values() for i in length.recordings}
    if in_passing is not None:
        evaluated |= {int(i) for i in in_passing.recordings}
    lengths = [
        _at_length(frames, own, recordings, labels, known, left_out)
        for frames in LENGTHS
        if (own := answers.get(frames)) is not None and len(own.recordings)
    ]
    return Comparison(
        left_out=left_out,
        participants=len({recordings[i].participant for i in evaluated}),
        lengths=lengths,
        in_passing=_at_length(0, in_passing, recordings, labels, known, left_out)
        if in_passing is not None and len(in_passing.recordings)
        else None,
    )


def _at_length(
    frames: int,
    answers: Answers,
    recordings: Sequence[Recording],
    labels: Sequence[str],
    known: Sequence[str],
    left_out: LeftOut,
) -> LengthFigures:
    truth = np.array([labels.index(recordings[i].gesture) for i in answers.recordings])
    evaluated = np.unique(answers.recordings)
    before = _shares(answers.before.argmax(axis=1) == truth, answers.recordings, evaluated)
    after = _shares(answers.after.argmax(axis=1) == truth, answers.recordings, evaluated)
    gesture = np.array([recordings[i].gesture for i in evaluated])
    participant = np.array([recordings[i].participant for i in evaluated])
    everything = np.ones(len(evaluated), dtype=bool)
    in_both = np.isin(gesture, known)

    def strata(shares: Floats, chosen: NDArray[np.bool_]) -> list[Floats]:
        per_gesture = _by(gesture[chosen], shares[chosen])
        if left_out != "participants":
            return per_gesture
        people = _by(participant[chosen], np.flatnonzero(chosen))
        return [np.array([_mean(_by(gesture[own], shares[own])) for own in people])]

    return LengthFigures(
        frames=frames,
        gestures={
            name: GestureFigures(
                recordings=len(own),
                before=float(before[gesture == name].mean()) if name in known else None,
                after=float(own.mean()),
                interval=wilson_interval(float(own.sum()), len(own)),
            )
            for name in labels
            if len(own := after[gesture == name])
        },
        before=_mean(strata(before, in_both)) if in_both.any() else None,
        after=_mean(strata(after, in_both)) if in_both.any() else None,
        interval=_interval(after - before, strata, in_both, left_out) if in_both.any() else None,
        all_after=_mean(strata(after, everything)),
    )


def _interval(
    gains: Floats,
    strata: Callable[[Floats, NDArray[np.bool_]], Sequence[Floats]],
    chosen: NDArray[np.bool_],
    left_out: LeftOut,
) -> tuple[float, float] | None:
    """Return the 95 % interval of a difference: over people, or over the recordings of one."""
    if left_out == "participants":
        return mean_interval(strata(gains, chosen))
    return paired_interval(gains[chosen])


def paired_interval(gains: Floats) -> tuple[float, float]:
    """Return the 95 % interval of a mean change of right answers (Agresti and Min 2005).

    gains: each recording's, -1 to 1. Two pretended recordings, one of which became right and one wrong by
    half, keep it from having no width where every recording changed equally.
    """
    n = len(gains) + 2
    better, worse = float(gains.clip(min=0).sum()), float(-gains.clip(max=0).sum())
    middle = (better - worse) / n
    reach = 1.96 * math.sqrt((better + worse + 1.0 - n * middle**2) / n**2)
    return max(-1.0, middle - reach), min(1.0, middle + reach)


def cross_entropy(logits: Floats, labels: NDArray[np.int64]) -> float:
    """Return the mean negative log likelihood of the true classes (N,) under logits (N, classes)."""
    return float(-log_softmax(logits, axis=1)[np.arange(len(labels)), labels].mean())


def mean_interval(strata: Sequence[Floats]) -> tuple[float, float] | None:
    """Return the 95 % t interval of the mean of the strata's means; None if it cannot be told.

    Unlike a bootstrap, it is wide enough with two or three values.
    """
    freedom = sum(len(stratum) - 1 for stratum in strata)
    if freedom < 1:
        return None
    pooled = sum(((stratum - stratum.mean()) ** 2).sum() for stratum in strata) / freedom
    # People who happen to change equally do not prove that everybody does.
    if pooled == 0.0:
        return None
    error = math.sqrt(pooled * sum(1.0 / len(stratum) for stratum in strata)) / len(strata)
    middle = _mean(strata)
    reach = float(stdtrit(freedom, UPPER)) * error
    return middle - reach, middle + reach


def wilson_interval(right: float, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson 1927); `right` may be fractional."""
    z = 1.96
    share = right / trials
    middle = (share + z * z / (2 * trials)) / (1 + z * z / trials)
    spread = math.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials))
    reach = z * spread / (1 + z * z / trials)
    return max(0.0, middle - reach), min(1.0, middle + reach)


def _shares(right: NDArray[np.bool_], owners: NDArray[np.int64], evaluated: NDArray[np.int64]) -> Floats:
    """Return the accuracy on each evaluated recording's windows."""
    return np.array([right[owners == recording].mean() for recording in evaluated], dtype=np.float64)


def _by(names: NDArray[np.str_], values: NDArray[np.generic]) -> list[Any]:
    """Return the values of each name."""
    return [values[names == name] for name in np.unique(names)]


def _mean(strata: Sequence[Floats]) -> float:
    return float(np.mean([stratum.mean() for stratum in strata]))
