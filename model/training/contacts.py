"""Finds the contacts of a hand within a recording. Does not import torch.

The studies recorded hands that repeat a gesture for eight seconds. A person who touches a robot in passing
makes one or a few of those contacts and leaves.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, NO_TOUCH, ROWS
from touchd.drivers.recording import Recording, setup_of

LEAVES = ("pat", "stroke")
"""Gestures whose hand leaves the pad between two contacts."""
# The lightest sixth of a second shows the rest of a pad that is touched repeatedly.
LIGHTEST_FRAMES = 9
MOST_SHIFTED_COUNTS = 8.0
# Counts of each taxel that are noise.
NOISE_COUNTS = 2.0
# A contact exceeds this share of the recording's 90th percentile of load. A soft pad creeps back so slowly
# that it exceeds the first share while the hand is off.
CONTACT_SHARE, SOFT_SHARE = 0.12, 0.35
LEAST_COUNTS = 4.0
# A shorter contact is noise; a shorter lift-off is part of the contact.
LEAST_FRAMES, LEAST_OFF_FRAMES = 2, 3
# A stroke takes at least 0.3 s; a shorter contact in a recording of strokes is a slip.
LEAST_STROKE_FRAMES = 16

Levels = NDArray[np.float32]
"""(8, 8) counts, in fractions."""


def lightest(counts: NDArray[np.generic]) -> Levels:
    """Return (8, 8) counts: the lightest sixth of a second of each taxel of (T, 8, 8)."""
    blocks = len(counts) // LIGHTEST_FRAMES
    cut = np.asarray(counts[: blocks * LIGHTEST_FRAMES], np.float32)
    medians = np.median(cut.reshape(blocks, LIGHTEST_FRAMES, ROWS, COLUMNS), axis=1)
    found: Levels = medians.min(axis=0)
    return found


def contacts(recording: Recording, *, is_soft: bool) -> list[tuple[int, int]]:
    """Return the complete contacts of a pat or stroke as (first frame, frame after the last), in order.

    is_soft: whether the pad creeps back slowly. Contacts at the ends of the recording are incomplete.
    """
    above = recording.counts - lightest(recording.counts) - NOISE_COUNTS
    level = np.maximum(above, 0.0).sum(axis=(1, 2))
    level = np.convolve(level, np.full(3, 1 / 3), "same")
    strong = float(np.percentile(level, 90))
    limit = max(LEAST_COUNTS, (SOFT_SHARE if is_soft else CONTACT_SHARE) * strong)
    joined: list[tuple[int, int]] = []
    for first, stop in _runs(level > limit):
        if stop - first < LEAST_FRAMES:
            continue
        if joined and first - joined[-1][1] < LEAST_OFF_FRAMES:
            joined[-1] = (joined[-1][0], stop)
        else:
            joined.append((first, stop))
    least = LEAST_STROKE_FRAMES if recording.gesture == "stroke" else LEAST_FRAMES
    return [
        (first, stop) for first, stop in joined if first > 0 and stop < len(level) and stop - first >= least
    ]


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the runs of a mask (T,) as (first, one after the last)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(stop)) for first, stop in edges.reshape(-1, 2)]


def rests_of(recordings: Sequence[Recording]) -> list[list[int]]:
    """Return, for each recording, the indices of those of its pad at rest: of its set-up, else its person."""
    of_set_up: dict[object, list[int]] = {}
    of_person: dict[str, list[int]] = {}
    for i, recording in enumerate(recordings):
        if recording.gesture == NO_TOUCH:
            of_set_up.setdefault(setup_of(recording), []).append(i)
            of_person.setdefault(recording.participant, []).append(i)
    return [
        of_set_up.get(setup_of(recording)) or of_person.get(recording.participant, [])
        for recording in recordings
    ]


def shift_of_rest(touched: NDArray[np.generic], resting: NDArray[np.generic]) -> Levels:
    """Return (8, 8) counts by which the pad's rest shifted while it was touched, as a fabric's does."""
    rest = np.median(np.asarray(resting, np.float32), axis=0)
    shift: Levels = np.clip(np.rint(lightest(touched) - rest), -MOST_SHIFTED_COUNTS, MOST_SHIFTED_COUNTS)
    return shift
