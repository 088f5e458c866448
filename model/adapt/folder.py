"""Reads and checks a folder of a lab's own recordings, and checks where the model is written.

Imports no torch, so that a command can refuse a path at once.
"""

import hashlib
import os
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from touchd.drivers.errors import TouchdError, os_errors_as
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, NO_TOUCH, ROWS
from touchd.drivers.recording import (
    UNLABELLED,
    Recording,
    RecordingError,
    read_recordings,
    realign,
    recordings_in,
    setup_of,
)
from touchd.model.adapt.passing import LEAST_AFTER_FRAMES, InPassing, concatenated, joined
from touchd.model.classifier import LONGEST_LABEL, MOST_LABELS, subtract_high_rest

# The first answer needs 54 frames.
SHORTEST_FRAMES = 54
GESTURE = re.compile(rf"[A-Za-z0-9][A-Za-z0-9_-]{{0,{LONGEST_LABEL - 1}}}")
# Reserved: events use it in place of a gesture.
RESERVED = "uncertain"
MODEL_SUFFIX = ".onnx"
# Why a saved touch is passed over.
NO_LABEL, CUT_SHORT = "without a label", "cut short by a gap, another touch or touchd's end"
NO_LABELS: Mapping[str, str] = {}


class ExtraError(TouchdError):
    """A folder of recordings cannot be used for training; the message names it, the reason and the remedy."""


class OutputError(TouchdError):
    """The adapted model cannot be written; the message says why and what to do."""


class Read(NamedTuple):
    """The contents of a folder. passed_over: how many saved touches are not used, by the reason."""

    recordings: list[Recording]
    passed_over: Mapping[str, int]


def read_all(
    folder: Path, known: Sequence[str], keep_all: bool = False, labels: Mapping[str, str] = NO_LABELS
) -> Read:
    """Return all recordings as whole scans at 54 Hz, in the order of the file names.

    A short touch comes with the rest around it: see `InPassing`. If the pad rests high, the rest is
    subtracted, as the daemon does for the network: see `subtract_high_rest`.
    known: gestures of the model to adapt. keep_all: whether it keeps those without recordings. labels: of
    saved touches, by file name. Raises ExtraError.
    """
    recordings: list[Recording] = []
    passed_over: Counter[str] = Counter()
    first_of: dict[bytes, Path] = {}
    for path in files_of(folder):
        parts = _labelled([realign(part) for part in read_file(path)], labels.get(path.name, UNLABELLED))
        if any(part.gesture == UNLABELLED for part in parts):
            passed_over[NO_LABEL] += 1
            continue
        found = joined(parts)
        passed_over[CUT_SHORT] += not found
        for recording in found:
            _check(path, recording, first_of)
        recordings += found
    if not recordings and passed_over[NO_LABEL]:
        raise ExtraError(
            f"{folder}: nobody has said what its touches were, or the journal that says it is not beside the "
            "folder; label touches on the live page (live.label) or with `touchd run --view`"
        )
    more = "label touches of another" if labels else f"make some with `touchd record {folder}`"
    _check_gestures(folder, {recording.gesture for recording in recordings}, known, keep_all, more)
    people = {recording.participant for recording in recordings} - {UNLABELLED}
    if len(people) == 1:
        # The daemon saves touches without a name.
        (person,) = people
        recordings = [replace(recording, participant=person) for recording in recordings]
    return Read(_subtract_high_rests(recordings), +passed_over)


def _labelled(parts: list[Recording], label: str) -> list[Recording]:
    """Label a saved touch; a false touch and the rest around it are one recording."""
    named = [replace(part, gesture=label) if part.gesture == UNLABELLED else part for part in parts]
    return [concatenated(named)] if label == NO_TOUCH else named


def _subtract_high_rests(recordings: Sequence[Recording]) -> list[Recording]:
    """Apply `subtract_high_rest`, with the rest of the recording's own set-up, or else of any other."""
    resting = {setup_of(each): each.counts for each in reversed(recordings) if each.gesture == NO_TOUCH}
    usual = next(iter(resting.values()), np.zeros((1, ROWS, COLUMNS)))
    found = []
    for each in recordings:
        rest = resting.get(setup_of(each), usual)
        if isinstance(each, InPassing):
            # The rest before the touch if it is long enough: afterwards a fabric's rest has shifted.
            is_enough = each.first >= LEAST_AFTER_FRAMES
            rest = each.counts[: each.first] if is_enough else each.counts[each.over :]
        level = np.median(rest, axis=0).astype(np.float32)
        found.append(replace(each, counts=subtract_high_rest(each.counts.astype(np.float32), level)))
    return found


def files_of(folder: Path) -> list[Path]:
    """Return the recording files; raises ExtraError if it is not a folder."""
    with os_errors_as(ExtraError, f"{folder}: cannot be read", "check the path"):
        return recordings_in(folder)


def read_file(path: Path) -> list[Recording]:
    """Read one file of the folder; raises ExtraError."""
    try:
        return read_recordings(path)
    except RecordingError as error:
        raise ExtraError(f"{error}; mend it, or move it to another folder") from error


def trouble_with(gestures: Collection[str], known: Collection[str] = ()) -> str:
    """Return what is wrong with gesture names, alone or beside the known ones; "" if nothing is."""
    for gesture in gestures:
        if gesture == RESERVED or not GESTURE.fullmatch(gesture):
            allowed = f"letters, digits, - and _ can, {LONGEST_LABEL} at most, but not {RESERVED!r}"
            return f"{gesture!r} cannot name a gesture; {allowed}"
    written: dict[str, str] = {}
    for gesture in sorted({*gestures, *known}):
        other = written.setdefault(re.sub(r"[-_]", "", gesture).lower(), gesture)
        if other != gesture:
            return f"{other} and {gesture} differ only in spelling; use one name for both"
    return ""


def _check(path: Path, recording: Recording, first_of: dict[bytes, Path]) -> None:
    """Raise ExtraError if a recording cannot be used. first_of: files so far, by digest of their counts."""
    if len(recording.counts) < SHORTEST_FRAMES and not isinstance(recording, InPassing):
        length_s, least_s = len(recording.counts) / FRAME_RATE_HZ, SHORTEST_FRAMES / FRAME_RATE_HZ
        raise ExtraError(
            f"{path}: {length_s:.2f} s of {recording.gesture} without a gap, and at least {least_s:g} s is "
            "needed; record it again, or delete the file"
        )
    # Cross-validation could train and score on duplicates.
    digest = hashlib.sha256(recording.counts.tobytes()).digest()
    if digest in first_of:
        raise ExtraError(f"{path}: the same recording as in {first_of[digest]}; delete one of them")
    first_of[digest] = path


def _check_gestures(
    folder: Path, gestures: set[str], known: Sequence[str], keep_all: bool, more: str
) -> None:
    if why := trouble_with(gestures, known):
        raise ExtraError(f"{folder}: {why}")
    if len(gestures) < 2:
        found = f"nothing but {', '.join(gestures)}" if gestures else "no recordings"
        raise ExtraError(f"{folder}: holds {found}, and telling apart takes two gestures; {more}")
    labels = gestures.union(known if keep_all else (), {NO_TOUCH})
    if len(labels) > MOST_LABELS:
        raise ExtraError(f"{folder}: {len(labels)} gestures; at most {MOST_LABELS} can be told apart")


def check_output(output: Path) -> None:
    """Raise OutputError unless a new .onnx file can be written there."""
    if output.suffix != MODEL_SUFFIX:
        raise OutputError(f"{output}: a model's name ends with {MODEL_SUFFIX}; give one with --output")
    if output.exists():
        raise OutputError(f"{output}: exists and is never overwritten; give another --output")
    if not os.access(output.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{output.parent}: nothing can be written there; give another --output")


def model_name(output: Path) -> str:
    """Return the model's name: its file's name, reduced to the characters that `Name` allows."""
    return re.sub(r"[^A-Za-z0-9_.+-]+", "-", output.stem)[:64]
