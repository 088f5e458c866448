"""Before and after, measured on what was left out, with how far to trust the difference."""

import math
from collections.abc import Mapping, Sequence
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
    """What was said of left-out windows of one length, over the labels of the adapted model.

    recordings: (W,) which one each window is cut from. before, after: logits (W, labels); before is -inf for
    gestures that the shipped model does not know.
    """

    recordings: NDArray[np.int64]
    before: Floats
    after: Floats


class GestureFigures(msgspec.Struct, frozen=True, kw_only=True):
    """One gesture's share of right answers among left-out windows, at one length.

    before: None where the shipped model does not know it. interval: of `after`, 95 % Wilson, counting a
    recording and not each of its windows as one trial.
    """

    recordings: int
    before: float | None
    after: float
    interval: tuple[float, float]


class LengthFigures(msgspec.Struct, frozen=True, kw_only=True):
    """What was said of all left-out windows of one length.

    before, after: macro accuracy over the gestures that the shipped model knows too, None without any; where
    participants were left out, the mean of theirs. interval: of the difference, 95 %, None where there is too
    little for one. all_after: as after, over all gestures.
    """

    frames: int
    gestures: dict[str, GestureFigures]
    before: float | None
    after: float | None
    interval: tuple[float, float] | None
    all_after: float

    @property
    def difference(self) -> float | None:
        """What adapting changed, over the gestures known before."""
        return None if self.before is None or self.after is None else self.after - self.before


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """Before and after on what was left out. left_out: participants, recordings, or nothing at all."""

    left_out: LeftOut
    participants: int
    lengths: list[LengthFigures]


def compare(
    answers: Mapping[int, Answers],
    recordings: Sequence[Recording],
    labels: Sequence[str],
    known: Sequence[str],
    left_out: LeftOut,
) -> Comparison:
    """Return the figures for left-out answers by length, of recordings by their number.

    labels: of the logits. known: those of the shipped model.
    """
    evaluated = sorted({int(i) for length in answers.values() for i in length.recordings})
    lengths = [
        _at_length(frames, own, recordings, labels, known, left_out)
        for frames in LENGTHS
        if (own := answers.get(frames)) is not None and len(own.recordings)
    ]
    participants = len({recordings[i].participant for i in evaluated})
    return Comparison(left_out=left_out, participants=participants, lengths=lengths)


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
        interval=mean_interval(strata(after - before, in_both)) if in_both.any() else None,
        all_after=_mean(strata(after, everything)),
    )


def cross_entropy(logits: Floats, labels: NDArray[np.int64]) -> float:
    """Return the mean negative log likelihood of the true classes (N,) under logits (N, classes)."""
    return float(-log_softmax(logits, axis=1)[np.arange(len(labels)), labels].mean())


def mean_interval(strata: Sequence[Floats]) -> tuple[float, float] | None:
    """Return the 95 % t interval of the mean of the strata's means; None where each holds but one value.

    Unlike a bootstrap, it stays honest with two or three values: it is then as wide as it must be.
    """
    freedom = sum(len(stratum) - 1 for stratum in strata)
    if freedom < 1:
        return None
    pooled = sum(((stratum - stratum.mean()) ** 2).sum() for stratum in strata) / freedom
    error = math.sqrt(pooled * sum(1.0 / len(stratum) for stratum in strata)) / len(strata)
    middle = _mean(strata)
    reach = float(stdtrit(freedom, UPPER)) * error
    return middle - reach, middle + reach


def wilson_interval(right: float, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson 1927); `right` may hold parts of a trial."""
    z = 1.96
    share = right / trials
    middle = (share + z * z / (2 * trials)) / (1 + z * z / trials)
    spread = math.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials))
    reach = z * spread / (1 + z * z / trials)
    return max(0.0, middle - reach), min(1.0, middle + reach)


def _shares(right: NDArray[np.bool_], owners: NDArray[np.int64], evaluated: NDArray[np.int64]) -> Floats:
    """Return each evaluated recording's share of right windows."""
    return np.array([right[owners == recording].mean() for recording in evaluated], dtype=np.float64)


def _by(names: NDArray[np.str_], values: NDArray[np.generic]) -> list[Any]:
    """Return the values of each name."""
    return [values[names == name] for name in np.unique(names)]


def _mean(strata: Sequence[Floats]) -> float:
    return float(np.mean([stratum.mean() for stratum in strata]))
