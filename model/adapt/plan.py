"""Cross-validation folds for a folder of recordings.

With two or more participants, participants are held out; with one, recordings. Windows of a recording are
never on both sides. A held-out recording is evaluated only if the fold trains on its gesture.
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
    """Numbers of the recordings to train on and of those held out and evaluated."""

    trained: tuple[int, ...]
    evaluated: tuple[int, ...]


@dataclass(frozen=True)
class Plan:
    """What is held out, and the folds."""

    left_out: LeftOut
    folds: tuple[Fold, ...]


def plan(recordings: Sequence[Recording]) -> Plan:
    """Return the folds; none if there are too few recordings to hold any out."""
    participants = sorted({recording.participant for recording in recordings})
    left_out: LeftOut
    if len(participants) > 1:
        left_out = "participants"
        fold_of = [
            participants.index(recording.participant) % MOST_PARTICIPANT_FOLDS for recording in recordings
        ]
    else:
        left_out = "recordings"
        # Distribute the recordings of each gesture over the folds.
        dealt: defaultdict[str, Iterator[int]] = defaultdict(itertools.count)
        fold_of = [next(dealt[recording.gesture]) % MOST_RECORDING_FOLDS for recording in recordings]
    folds = []
    for fold in sorted(set(fold_of)):
        trained = tuple(i for i, own in enumerate(fold_of) if own != fold)
        gestures = {recordings[i].gesture for i in trained}
        evaluated = tuple(
            i for i, own in enumerate(fold_of) if own == fold and recordings[i].gesture in gestures
        )
        # With one label, accuracy is trivially 100 %.
        if evaluated and len(gestures) > 1:
            folds.append(Fold(trained, evaluated))
    return Plan(left_out if folds else "nothing", tuple(folds))
