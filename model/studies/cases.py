"""HAART's gestures spliced between notouch, to measure how soon a touch is found.

HAART's recordings are cut from the middle of a gesture, so the onsets are artificial: five seconds of notouch
by the same participant on the same substrate and cover, the gesture, then the remaining notouch. Two things
differ from a real pad. The pad's rest differs by a few counts between recordings, and that step alone can be
detected; so everything is measured twice, as recorded and with the notouch shifted to the gesture's own rest.
And some gestures begin during a lift-off; so delays count from the first scan with visible pressure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.path.tracker import Onset, TouchSettings, TouchTracker
from touchd.drivers.frame import FRAME_RATE_HZ, NO_TOUCH
from touchd.drivers.pad.grid import GridFrame
from touchd.drivers.recording import Recording, setup_of
from touchd.model.detector import Detector

Scans = NDArray[np.float32]

LEAD_FRAMES = 270
# No single scan of a notouch recording is more than 19 counts above its rest.
VISIBLE_COUNTS = 20.0
# The mean noise floor of a pad at rest.
NOISE_COUNTS = 1.6
# A mostly untouched taxel rests at its 20th percentile, or 0.6 counts above it if it has 0.8 counts of noise.
REST_PERCENTILE = 20
REST_OFFSET_COUNTS = 0.6


@dataclass(frozen=True, eq=False)
class Case:
    """One spliced stream: scans (T, 8, 8) counts; the gesture is in start <= index < stop.

    visible: (T,) whether a scan shows more pressure than any of notouch does; only within the gesture.
    """

    participant: str
    gesture: str
    scans: Scans
    start: int
    stop: int
    visible: NDArray[np.bool_]

    @property
    def visible_at(self) -> int | None:
        """The first scan with visible pressure."""
        return int(self.visible.argmax()) if self.visible.any() else None


def spliced(recordings: Sequence[Recording], level_rest: bool) -> list[Case]:
    """Return a case for each touching recording; there must be a notouch one for each condition."""
    quiet = {setup_of(recording): recording for recording in recordings if recording.gesture == NO_TOUCH}
    cases = []
    for recording in recordings:
        if recording.gesture == NO_TOUCH:
            continue
        gesture = recording.counts.astype(np.float32)
        rest = quiet[setup_of(recording)].counts.astype(np.float32)
        # A resting hand never leaves the pad, so its recording does not show the pad's own rest.
        if level_rest and recording.gesture != "constant":
            own_rest = np.percentile(gesture, REST_PERCENTILE, axis=0) + REST_OFFSET_COUNTS
            rest = (rest + own_rest - np.median(rest, axis=0)).astype(np.float32)
        scans = np.concatenate([rest[:LEAD_FRAMES], gesture, rest[LEAD_FRAMES:]])
        start, stop = LEAD_FRAMES, LEAD_FRAMES + len(gesture)
        rise = scans - np.median(rest[:LEAD_FRAMES], axis=0)
        above = np.maximum(rise - NOISE_COUNTS, 0).sum(axis=(1, 2))
        visible = above >= VISIBLE_COUNTS
        visible[:start] = visible[stop:] = False
        cases.append(Case(recording.participant, recording.gesture, scans, start, stop, visible))
    return cases


def first_touch(scans: Scans, detector: Detector) -> tuple[int, int] | None:
    """Return the frame at which the first touch in (T, 8, 8) counts began, and when it was detected."""
    tracker = TouchTracker(TouchSettings(), detector)
    for index, scan in enumerate(scans):
        frame = GridFrame(index, index * 1000 / FRAME_RATE_HZ, 0.0, scan, False, index == 0)
        match tracker.update(frame):
            case Onset(first):
                return first, index
    return None
