"""Detects when a touch begins and ends.

A small network, the detector, gives for each frame the probability that a hand is on the pad. The tracker is
in one of three states:

measuring rest: half a second of frames without a gap shows the untouched pad; then quiet.
quiet: rest and noise follow the pad. A touch begins after some frames in which the detector is sure of a
    hand. If one is only likely, the classifier has to confirm it after 0.1 or 0.2 s, even if it has left.
touched: rest and noise stay unchanged. The touch ends after `quiet_s` without a hand. But a hand may leave
    behind a load that looks like a hand. So if for `quiet_s` the detector is unsure, or the load is low next
    to its maximum, the classifier decides whether the hand has left. If so, the load becomes rest.

A gap in the frames ends a touch. After a long gap, or with another sensor, rest is measured again. A load
that keeps still for ten seconds also becomes part of the rest.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.daemon.path.events import EndReason
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS
from touchd.drivers.pad.grid import GridFrame
from touchd.model.detector import (
    BEGIN_FRAMES,
    BEGINS,
    GOES_ON,
    LIKELY,
    REST_FRAMES,
    SURE,
    Detector,
    DetectorState,
    after_gap,
    at_rest,
)

Sensitivity: TypeAlias = Literal["low", "normal", "high"]

TAXELS = ROWS * COLUMNS
SECOND_FRAMES = 2 * REST_FRAMES
# After a longer gap, rest is measured again: it may be another pad.
CHANGED_AFTER_MS = 2000.0
# The load is the sum over the pad of the counts above rest, averaged over some frames, less these standard
# deviations of noise.
SMOOTH_FRAMES, NOISE_DEVIATIONS = 3, 2.0
# A taxel keeps still if its means over two successive half seconds differ by at most this many counts, or
# this share of its load. A jacket laid on the pad settles like that; a resting hand does not.
STILL_COUNTS, STILL_SHARE = 1.0, 0.03
SETTLED_FRAMES = round(10 * FRAME_RATE_HZ)
LONGEST_FRAMES = round(600 * FRAME_RATE_HZ)
# The classifier is asked this many frames after a hand became likely, even if the hand has left: a blow is
# short. A touch begins if its probability of a hand exceeds the value here. It must be higher after fewer
# frames, or a rest that steps by hundreds of counts begins touches, as on the robot. When a touch may be
# over, the hand is still there if this probability exceeds STILL_HAND.
ASKED: Mapping[int, float] = MappingProxyType({6: 0.92, 11: LIKELY})
STILL_HAND = 0.5
# A hand may have left a load behind (a fold, a material that creeps) if it is below LEFT_SHARE of the touch's
# highest load and does not rise by RISE_SHARE of that.
LEFT_SHARE, RISE_SHARE = 0.5, 0.15
# From which probability on a hand is likely.
SENSITIVITIES: dict[Sensitivity, float] = {"low": 0.85, "normal": LIKELY, "high": 0.5}

Taxels: TypeAlias = NDArray[np.float32]
Question: TypeAlias = Callable[[NDArray[np.float32], Taxels], float]
"""The classifier's probability that nothing touches a pad in (T, 8, 8) counts that rests at (64,) counts."""


class TouchSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When a touch begins and ends.

    sensitivity: high finds lighter touches, and more false ones; docs/sessions.md has the figures.
    quiet_s: seconds of quiet that end a touch; longer than the lift-off between two strokes.
    """

    sensitivity: Sensitivity = "normal"
    quiet_s: Annotated[float, msgspec.Meta(ge=0.1, le=5.0)] = 0.8


@dataclass(frozen=True, slots=True)
class Onset:
    """A touch was detected; first_index is the grid frame at which it began, which is earlier."""

    first_index: int


@dataclass(frozen=True, slots=True)
class Release:
    """The touch is over; first_index and last_index are its first and last grid frame with contact."""

    first_index: int
    last_index: int
    reason: EndReason


Change: TypeAlias = Onset | Release | None


@dataclass(slots=True)
class MeasuringRest:
    """Rest is not known yet. frames: so far without a gap."""

    frames: int = 0


@dataclass(slots=True)
class Quiet:
    """No hand is on the pad.

    since: the first frame. empty: the last frame that shows no sign of a hand. sure: the number of frames for
    which the detector has been sure of a hand. likely: the number of frames since a hand first was likely.
    """

    since: int
    empty: int
    sure: int = 0
    likely: int = 0


@dataclass(slots=True)
class Touched:
    """An ongoing touch.

    first, last: the first frame, and the last with a hand. held: the last frame in which a hand surely causes
    the load. highest: the highest load. lowest: the lowest since `held`. is_low: whether the load is low
    compared with the highest. still_frames: for how long the load has kept still. level: (64,), the mean of
    the half second before the last check.
    """

    first: int
    last: int
    held: int
    highest: float = 0.0
    lowest: float = math.inf
    is_low: bool = False
    still_frames: int = 0
    level: Taxels | None = None


class TouchTracker:
    """Takes the pad's frames one by one and returns where touches begin and end.

    p_no_touch: asks the classifier; None if it does not know "notouch". is_finer: whether the pad has more
    cells than 8x8. The classifier was not trained on such pads: there it takes what a hand leaves for a hand.
    """

    def __init__(
        self,
        settings: TouchSettings,
        detector: Detector,
        p_no_touch: Question | None = None,
        *,
        is_finer: bool = False,
    ) -> None:
        self._quiet_frames = round(settings.quiet_s * FRAME_RATE_HZ)
        self._likely = SENSITIVITIES[settings.sensitivity]
        self._detector, self._p_no_touch, self._is_finer = detector, p_no_touch, is_finer
        self._known: DetectorState = detector.begin(np.zeros((2, TAXELS), np.float32))
        self._recent = np.zeros((SECOND_FRAMES, TAXELS), np.float32)
        self._state: MeasuringRest | Quiet | Touched = MeasuringRest()
        self._index, self._sensor_ms = -1, 0.0

    @property
    def rest(self) -> Taxels:
        """What each of the 64 taxels reads untouched, in counts; unchanged during a touch."""
        return np.asarray(self._known["levels"][0, 0])

    @property
    def noise(self) -> Taxels:
        """Standard deviation of each of the 64 taxels at rest, in counts."""
        return np.asarray(self._known["noise"][0, 0])

    @property
    def is_untouched(self) -> bool:
        """Whether no hand has been on the pad for two seconds."""
        return isinstance(self._state, Quiet) and self._index - self._state.since >= 2 * SECOND_FRAMES

    @property
    def last_contact_index(self) -> int:
        """The current touch's last grid frame with a hand."""
        return self._state.last if isinstance(self._state, Touched) else self._index

    def update(self, frame: GridFrame) -> Change:
        """Take the next grid frame; return the touch that it begins or ends."""
        counts = frame.pressure.reshape(TAXELS)
        release = self._restart(frame, counts) if frame.restarted else None
        self._index, self._sensor_ms = frame.index, frame.sensor_ms
        self._recent[:-1] = self._recent[1:]
        self._recent[-1] = counts
        state = self._state
        if isinstance(state, MeasuringRest):
            state.frames += 1
            if state.frames == REST_FRAMES:
                self._known = self._detector.begin(self._recent[-REST_FRAMES:])
                self._state = Quiet(self._index, self._index)
            return release
        is_touch = isinstance(state, Touched)
        probability, self._known = self._detector.step(counts, self._known, is_touch=is_touch)
        if isinstance(state, Touched):
            return self._hold(state, probability)
        return release or self._watch(state, probability)

    def forget(self, reason: EndReason) -> Release | None:
        """End the current touch, if any, and measure rest again: it may be another pad."""
        release = self._end(self._state, reason) if isinstance(self._state, Touched) else None
        self._state = MeasuringRest()
        return release

    def _restart(self, frame: GridFrame, counts: Taxels) -> Release | None:
        """End the touch at a gap in the frames; measure rest again after a long one.

        The next touch begins after the gap, so that no touch contains it.
        """
        release = None
        if isinstance(self._state, Touched):
            release = Release(self._state.first, self._state.last, "gap")
            self._state = Quiet(self._index, self._index)
        is_long = not 0 < frame.sensor_ms - self._sensor_ms <= CHANGED_AFTER_MS
        if is_long or isinstance(self._state, MeasuringRest):
            self._state = MeasuringRest()
        else:
            self._state = Quiet(self._state.since, self._index)
            self._known = after_gap(self._known, counts)
        return release

    def _watch(self, quiet: Quiet, probability: float) -> Onset | None:
        quiet.sure = quiet.sure + 1 if probability > BEGINS else 0
        is_likely = probability > self._likely
        # Once a hand was likely, count on until the classifier is asked, even if the hand leaves.
        stays = quiet.likely > 0 and self._p_no_touch is not None
        quiet.likely = quiet.likely + 1 if is_likely or stays else 0
        if probability <= GOES_ON and not quiet.likely:
            quiet.empty = self._index
        is_sure = quiet.sure >= BEGIN_FRAMES or probability > SURE
        if not is_sure and not self._is_confirmed(quiet.likely):
            if quiet.likely == max(ASKED):
                quiet.likely = 0
                if is_likely:
                    self._rest_now(forgets_hand=True)
            return None
        first = min(max(quiet.empty + 1, self._index - SECOND_FRAMES), self._index)
        self._state = Touched(first, self._index, self._index)
        return Onset(first)

    def _is_confirmed(self, frames: int) -> bool:
        """Whether the classifier, if it is asked after this many frames, confirms a likely hand."""
        return frames in ASKED and self._p_hand(frames) > ASKED[frames]

    def _hold(self, touch: Touched, probability: float) -> Release | None:
        if probability > GOES_ON:
            touch.last = self._index
        if self._is_held(touch, probability):
            touch.held, touch.lowest = self._index, math.inf
        if self._index - touch.last >= self._quiet_frames:
            self._rest_now(forgets_hand=False)
            return Release(touch.first, touch.last, "released")
        if self._index - touch.held >= self._quiet_frames:
            if self._is_left(touch):
                touch.last = max(touch.first, min(touch.last, touch.held))
                return self._end(touch, "released")
            touch.held = self._index
        if self._has_settled(touch):
            return self._end(touch, "settled")
        return self._end(touch, "longest") if self._index - touch.first >= LONGEST_FRAMES else None

    def _is_held(self, touch: Touched, probability: float) -> bool:
        """Whether a hand surely causes the load, rather than having left it behind."""
        above = self._recent[-SMOOTH_FRAMES:].mean(axis=0) - self.rest - NOISE_DEVIATIONS * self.noise
        load = float(np.maximum(above, 0.0).sum())
        touch.highest, touch.lowest = max(touch.highest, load), min(touch.lowest, load)
        touch.is_low = load <= LEFT_SHARE * touch.highest
        is_rising = load > touch.lowest + RISE_SHARE * touch.highest
        return (is_rising or not touch.is_low) and (self._is_finer or probability > LIKELY)

    def _is_left(self, touch: Touched) -> bool:
        """Whether the hand has left the load behind; without asking, if the load is low and keeps still."""
        if touch.is_low and (self._is_finer or self._is_still()):
            return True
        return not self._is_finer and self._p_hand(self._quiet_frames) <= STILL_HAND

    def _is_still(self) -> bool:
        half = min(self._quiet_frames, SECOND_FRAMES) // 2
        before, now = self._recent[-2 * half :].reshape(2, half, TAXELS).mean(axis=1)
        return self._keeps_still(before, now)

    def _keeps_still(self, before: Taxels, now: Taxels) -> bool:
        allowed = np.maximum(STILL_SHARE * (now - self.rest), np.maximum(STILL_COUNTS, self.noise))
        return bool((np.abs(now - before) <= allowed).all())

    def _p_hand(self, frames: int) -> float:
        """Return the classifier's probability of a hand in the last frames, at most a second of them."""
        if self._p_no_touch is None:
            return 1.0
        asked = self._recent[-min(frames, SECOND_FRAMES) :].reshape(-1, ROWS, COLUMNS)
        return 1.0 - self._p_no_touch(asked, self.rest)

    def _has_settled(self, touch: Touched) -> bool:
        """Whether the load has kept still for ten seconds, checked every half second."""
        if (self._index - touch.first) % REST_FRAMES:
            return False
        level = self._recent[-REST_FRAMES:].mean(axis=0)
        if touch.level is not None:
            is_still = self._keeps_still(touch.level, level)
            touch.still_frames = touch.still_frames + REST_FRAMES if is_still else 0
        touch.level = level
        return touch.still_frames >= SETTLED_FRAMES

    def _end(self, touch: Touched, reason: EndReason) -> Release:
        self._rest_now(forgets_hand=True)
        return Release(touch.first, touch.last, reason)

    def _rest_now(self, *, forgets_hand: bool) -> None:
        """Take the present counts as rest. forgets_hand: whether to clear the detector's memory of a hand."""
        self._known = at_rest(self._known, self._recent[-REST_FRAMES:], forgets_hand=forgets_hand)
        self._state = Quiet(self._index, self._index)
