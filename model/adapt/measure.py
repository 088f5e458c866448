"""Accuracy on held-out recordings before and after adapting, with confidence intervals."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
    """Accuracy for one gesture on held-out windows. before: None if the shipped model lacks the gesture."""

    recordings: int
    before: float | None
    after: float


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
) -> Comparison:
    """Return the figures for held-out answers at each length, 0 for ended touches in passing.

    labels: of the logits. known: those of the shipped model.
    """
    found = {
        frames: _at_length(frames, own, recordings, labels, known, left_out)
        for frames, own in answers.items()
        if len(own.recordings)
    }
    evaluated = {int(i) for own in answers.values() for i in own.recordings}
    return Comparison(
        left_out=left_out,
        participants=len({recordings[i].participant for i in evaluated}),
        lengths=[found[frames] for frames in LENGTHS if frames in found],
        in_passing=found.get(0),
    )


def _at_length(
    frames: int,
    answers: Answers,
    recordings: Sequence[Recording],
    labels: Sequence[str],
    known: Sequence[str],
    left_out: LeftOut,
) -> LengthFigures:
    owners, evaluated = answers.recordings, np.unique(answers.recordings)
    truth = np.array([labels.index(recordings[i].gesture) for i in owners])
    before, after = (
        np.array([(logits.argmax(axis=1) == truth)[owners == each].mean() for each in evaluated])
        for logits in (answers.before, answers.after)
    )
    gesture = np.array([recordings[i].gesture for i in evaluated])
    person = np.array([recordings[i].participant for i in evaluated])
    group = person if left_out == "participants" else np.zeros(len(evaluated))
    in_both, everything = np.isin(gesture, known), np.ones(len(evaluated), dtype=bool)

    def macro(shares: Floats, chosen: NDArray[np.bool_]) -> Floats:
        """Return the mean over gestures, of each person if people are held out, else of all."""
        return np.array(
            [_macro(gesture, shares, chosen & (group == each)) for each in np.unique(group[chosen])]
        )

    interval = None
    if in_both.any():
        gains = after - before
        by_people = left_out == "participants"
        interval = mean_interval(macro(gains, in_both)) if by_people else paired_interval(gains[in_both])
    return LengthFigures(
        frames=frames,
        gestures=_by_gesture(labels, known, gesture, before, after),
        before=float(macro(before, in_both).mean()) if in_both.any() else None,
        after=float(macro(after, in_both).mean()) if in_both.any() else None,
        interval=interval,
        all_after=float(macro(after, everything).mean()),
    )


def _by_gesture(
    labels: Sequence[str], known: Sequence[str], gesture: NDArray[np.str_], before: Floats, after: Floats
) -> dict[str, GestureFigures]:
    """Return the figures of each label that a recording has."""
    return {
        name: GestureFigures(
            recordings=int(own.sum()),
            before=float(before[own].mean()) if name in known else None,
            after=float(after[own].mean()),
        )
        for name in labels
        if (own := gesture == name).any()
    }


def _macro(gesture: NDArray[np.str_], shares: Floats, chosen: NDArray[np.bool_]) -> float:
    """Return the mean over gestures of the chosen recordings' shares."""
    return float(np.mean([shares[chosen & (gesture == name)].mean() for name in np.unique(gesture[chosen])]))


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


def mean_interval(values: Floats) -> tuple[float, float] | None:
    """Return the 95 % t interval of a mean; None if it cannot be told.

    Unlike a bootstrap, it is wide enough with two or three values.
    """
    # People who happen to change equally do not prove that everybody does.
    if len(values) < 2 or values.std() == 0.0:
        return None
    middle = float(values.mean())
    reach = float(stdtrit(len(values) - 1, UPPER) * values.std(ddof=1) / math.sqrt(len(values)))
    return middle - reach, middle + reach
