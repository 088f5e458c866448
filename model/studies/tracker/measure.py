"""How well touches are detected: HAART's gestures spliced between notouch, run through the real tracker.

HAART's recordings are cut from the middle of a gesture, so the onsets are artificial: five seconds of notouch
by the same participant on the same substrate and cover, the gesture, then the remaining notouch. Two things
differ from a real pad. The pad's rest differs by a few counts between recordings, and that step alone can be
detected; so everything is measured twice, as recorded and with the notouch shifted to the gesture's own rest.
And some gestures begin during a lift-off; so delays count from the first scan with visible pressure.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.path.tracker.baseline import MIN_NOISE_FLOOR
from touchd.daemon.path.tracker.tracker import CALIBRATION_FRAMES, Onset, Release, TouchSettings, TouchTracker
from touchd.drivers.frame import FRAME_RATE_HZ, NO_TOUCH
from touchd.drivers.pad.grid import GridFrame
from touchd.drivers.recording import Recording, set_up

Scans = NDArray[np.float32]

LEAD_FRAMES = 270
# No single scan of a notouch recording is more than 19 counts above its rest.
VISIBLE_COUNTS = 20.0
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


@dataclass(frozen=True)
class TrackedTouch:
    """A touch as the tracker saw it, in frame indices; ended is None while it goes on."""

    detected: int
    first: int
    last: int
    ended: int | None


@dataclass(frozen=True)
class Outcome:
    """The outcome of one gesture; delays in frames, None when it was missed (or never visible)."""

    gesture: str
    delay_from_splice: int | None
    delay_from_visible: int | None
    first_error: int | None
    touches: int
    lost_frames: int
    released: bool


def spliced(recordings: Sequence[Recording], level_rest: bool) -> list[Case]:
    """Return a case for each touching recording; there must be a notouch one for each condition."""
    quiet = {set_up(recording): recording for recording in recordings if recording.gesture == NO_TOUCH}
    cases = []
    for recording in recordings:
        if recording.gesture == NO_TOUCH:
            continue
        gesture = recording.counts.astype(np.float32)
        rest = quiet[set_up(recording)].counts.astype(np.float32)
        # A resting hand never leaves the pad, so its recording does not show the pad's own rest.
        if level_rest and recording.gesture != "constant":
            own_rest = np.percentile(gesture, REST_PERCENTILE, axis=0) + REST_OFFSET_COUNTS
            rest = (rest + own_rest - np.median(rest, axis=0)).astype(np.float32)
        scans = np.concatenate([rest[:LEAD_FRAMES], gesture, rest[LEAD_FRAMES:]])
        start, stop = LEAD_FRAMES, LEAD_FRAMES + len(gesture)
        rise = scans - np.median(rest[:LEAD_FRAMES], axis=0)
        above = np.maximum(rise - MIN_NOISE_FLOOR, 0).sum(axis=(1, 2))
        visible = above >= VISIBLE_COUNTS
        visible[:start] = visible[stop:] = False
        cases.append(Case(recording.participant, recording.gesture, scans, start, stop, visible))
    return cases


def detect(scans: Scans, settings: TouchSettings) -> Iterator[TrackedTouch]:
    """Run a tracker over (T, 8, 8) counts; yield each touch when detected (ended None) and when ended."""
    tracker = TouchTracker(settings)
    detected = first = 0
    for index, scan in enumerate(scans):
        match tracker.update(GridFrame(index, index * 1000 / FRAME_RATE_HZ, 0.0, scan, False, index == 0)):
            case Onset(first):
                detected = index
                yield TrackedTouch(detected, first, index, None)
            case Release(_, last, _):
                yield TrackedTouch(detected, first, last, index)


def delay(case: Case, settings: TouchSettings) -> int | None:
    """Return frames from the first visible pressure (0 when it was detected before), None for a miss."""
    touches = detect(case.scans[: case.stop], settings)
    detected = next((touch.detected for touch in touches if touch.detected >= case.start), None)
    if detected is None:
        return None
    return 0 if case.visible_at is None else max(0, detected - case.visible_at)


def outcome(case: Case, settings: TouchSettings) -> Outcome:
    """Run one case to its end. lost_frames: visible frames after the first detection that are in no touch."""
    touches = {touch.detected: touch for touch in detect(case.scans, settings)}
    within = [touch for touch in touches.values() if case.start <= touch.detected < case.stop]
    if not within:
        return Outcome(case.gesture, None, None, None, 0, 0, True)
    first = within[0]
    covered = np.zeros(len(case.scans), np.bool_)
    for touch in within:
        covered[touch.first : touch.ended] = True
    return Outcome(
        gesture=case.gesture,
        delay_from_splice=first.detected - case.start,
        delay_from_visible=None if case.visible_at is None else first.detected - case.visible_at,
        first_error=None if case.visible_at is None else first.first - case.visible_at,
        touches=len(within),
        lost_frames=int((case.visible & ~covered)[first.detected :].sum()),
        released=within[-1].ended is not None,
    )


def false_touches(scans: Scans, settings: TouchSettings) -> int:
    """Return the number of touches detected in (T, 8, 8) counts of a pad that nothing touches."""
    return sum(touch.ended is None for touch in detect(scans, settings))


def join_touches(recordings: Sequence[Recording], settings: TouchSettings) -> tuple[int, int]:
    """Join one participant's notouch recordings; return the number of joins, and how many began a touch."""
    joins = np.cumsum([len(recording.counts) for recording in recordings])[:-1]
    scans = np.concatenate([recording.counts for recording in recordings]).astype(np.float32)
    detected = np.array([touch.detected for touch in detect(scans, settings) if touch.ended is None])
    near = [((detected >= join) & (detected < join + CALIBRATION_FRAMES)).any() for join in joins]
    return len(joins), int(sum(near))
