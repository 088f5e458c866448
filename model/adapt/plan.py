"""Cross-validation folds: who is left out in turn.

With two participants or more, whole participants; with one, recordings. Never are windows of one recording on
both sides. A recording counts only where the gesture was learnt from another one on the other side.
"""

import itertools
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from touchd.drivers.recording import Recording

LeftOut = Literal["participants", "recordings", "nothing"]
MOST_PARTICIPANT_FOLDS = 20
MOST_RECORDING_FOLDS = 4


@dataclass(frozen=True)
class Fold:
    """Recordings by number: those trained on, and those left out and evaluated."""

    trained: tuple[int, ...]
    evaluated: tuple[int, ...]


@dataclass(frozen=True)
class Plan:
    """What is left out, and the folds."""

    left_out: LeftOut
    folds: tuple[Fold, ...]


def plan(recordings: Sequence[Recording]) -> Plan:
    """Return the folds for a folder's recordings; none where too few are there to leave any out."""
    participants = sorted({recording.participant for recording in recordings})
    left_out: LeftOut
    if len(participants) > 1:
        left_out = "participants"
        fold_of = [
            participants.index(recording.participant) % MOST_PARTICIPANT_FOLDS for recording in recordings
        ]
    else:
        left_out = "recordings"
        # Those of a gesture are dealt out one after the other.
        dealt: defaultdict[str, Iterator[int]] = defaultdict(itertools.count)
        fold_of = [next(dealt[recording.gesture]) % MOST_RECORDING_FOLDS for recording in recordings]
    folds = []
    for fold in sorted(set(fold_of)):
        trained = tuple(i for i, own in enumerate(fold_of) if own != fold)
        gestures = {recordings[i].gesture for i in trained}
        evaluated = tuple(
            i for i, own in enumerate(fold_of) if own == fold and recordings[i].gesture in gestures
        )
        # Told from nothing else, any gesture would be right.
        if evaluated and len(gestures) > 1:
            folds.append(Fold(trained, evaluated))
    return Plan(left_out if folds else "nothing", tuple(folds))
