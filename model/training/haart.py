"""The HAART recordings as training and test data: folder, participants, windows.

Source: Human-Animal Affective Robot Touch set, RTGC 2015, UBC SPIN lab.
"""

import gzip
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import OTHER, Counts
from touchd.drivers.recording import Recording, RecordingError, read_recordings, realign

TRAINING_FILE = "training.csv"
TEST_FILE = "testWITHLABELS.csv"
PUBLISHED_FRAMES = 432
GESTURES = ("constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle")
LABELS = (*GESTURES, OTHER)


@dataclass(frozen=True, eq=False)
class Windows:
    """Equal windows cut from recordings: counts (N, L, 8, 8) uint16, labels (N,) int64.

    participants, conditions: (N,), whose window it is, and on which substrate under which cover.
    """

    counts: Counts
    labels: NDArray[np.int64]
    participants: NDArray[np.str_]
    conditions: NDArray[np.str_]


def read_training(folder: Path) -> list[Recording]:
    """Read the 578 published recordings of participants P3 to P8 and P10."""
    return read_recordings(find(folder, TRAINING_FILE))


def read_test(folder: Path) -> list[Recording]:
    """Read the 251 published recordings of participants T1, T2 and T9."""
    return read_recordings(find(folder, TEST_FILE))


def find(folder: Path, name: str, hint: str = "`python -m touchd.model.studies data` fetches it") -> Path:
    """Return the file `name`, or `name`.gz, in the folder; raises RecordingError when neither is there."""
    for path in (folder / name, folder / f"{name}.gz"):
        if path.is_file():
            return path
    raise RecordingError(f"{folder}: neither {name} nor {name}.gz is there; {hint}")


def open_table(folder: Path, name: str, hint: str) -> TextIO:
    """Open a CSV file of the folder, packed or not; raises RecordingError as `find` does."""
    path = find(folder, name, hint)
    return gzip.open(path, "rt", newline="") if path.suffix == ".gz" else path.open(newline="")


def without(recordings: Iterable[Recording], participants: Sequence[str]) -> list[Recording]:
    """Return the recordings of everyone else."""
    return [recording for recording in recordings if recording.participant not in participants]


def only(recordings: Iterable[Recording], participants: Sequence[str]) -> list[Recording]:
    """Return the recordings of these participants."""
    return [recording for recording in recordings if recording.participant in participants]


def realigned(recordings: Iterable[Recording]) -> list[Recording]:
    """Return every recording as the sensor's own scans; see `touchd.drivers.recording.realign`."""
    return [realign(recording) for recording in recordings]


def label(recording: Recording) -> int:
    """Return the recording's class, an index into the labels of a network: GESTURES, then `other`."""
    return LABELS.index(recording.gesture)


def cut(recordings: Sequence[Recording], length: int) -> Windows:
    """Cut each recording into non-overlapping windows, as the paper does: 432 // length of HAART's.

    A realigned recording is one frame short; its last window then begins one frame early.
    """
    counts: list[Counts | NDArray[np.float32]] = []
    labels: list[int] = []
    participants: list[str] = []
    conditions: list[str] = []
    for recording in recordings:
        for window in range((len(recording.counts) + 1) // length):
            start = min(window * length, len(recording.counts) - length)
            counts.append(recording.counts[start : start + length])
            labels.append(label(recording))
            participants.append(recording.participant)
            conditions.append(f"{recording.substrate}, {recording.cover}")
    return Windows(
        np.stack(counts), np.array(labels, dtype=np.int64), np.array(participants), np.array(conditions)
    )
