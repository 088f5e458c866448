"""When a touch begins and ends.

Contact is the pressure by which taxels exceed the baseline, the rise that half of the taxels share and their
own noise floors, summed over the pad: a light stroke is hardly above noise in any one taxel, but in many at
once. The tracker is in one of four states:

measuring rest: the first half second of frames without a gap becomes the baseline; then quiet.
quiet: the baseline follows the pad. Contact leads to maybe; a touch that only the network sees, to touched.
maybe: light contact may be a shifted baseline or a pad that wobbles. If contact is firm, or goes on moving
    and the network agrees, touched. Without contact for half a second, quiet. Undecided after a second, quiet
    with the current readings as the baseline.
touched: ends after `quiet_s` without contact, or when stillness or the network shows that nobody touches the
    pad even if it has not returned to the baseline; its readings then become the baseline. Then quiet.

A gap in the frames ends a touch. After a long gap, or with another sensor, rest is measured again.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.daemon.path.events import EndReason
from touchd.daemon.path.tracker.baseline import (
    MAX_DEVIATION_COUNTS,
    SECOND_FRAMES,
    TAXELS,
    Baseline,
    LastSecond,
    Taxels,
)
from touchd.daemon.path.tracker.loose_wire import LINES, LOOK_FRAMES, LooseWire
from touchd.daemon.path.tracker.network_check import ASK_FRAMES, DOUBT, NONE, TOUCH, NetworkCheck, Question
from touchd.drivers.frame import FRAME_RATE_HZ, ROWS
from touchd.drivers.pad.grid import GridFrame

# A median over three frames halves the noise and removes a single broken frame; it delays by one frame.
SMOOTH_FRAMES = 3
CALIBRATION_FRAMES = SECOND_FRAMES // 2
# After a longer gap, rest is measured again: it may be another pad.
CHANGED_AFTER_MS = 2000.0
# Checks of the last second take place six times a second.
CHECK_FRAMES = ASK_FRAMES // 2

# Quiet.
# Contact that may be a touch; docs/sessions.md compares levels. If onset_threshold is set higher than this
# default, the network alone does not begin a touch.
ONSET_COUNTS = 4.0
# A loose wire may lift a row or column by up to this many counts in total, which are not contact.
WIRE_COUNTS = 25.0
# Contact must exceed the untouched pad's recent peak by half; the peak halves in 13 seconds. Without this
# rule, there is one more false touch in ten minutes on the robot.
RESTLESS_FACTOR = 1.5
RESTLESS_KEPT = 0.999
# It is at most this: a hug that begins slowly, or leaves slowly, would otherwise hide itself and the next.
# What a hand has left rises by as much. Contact that moves by half more in a third of a second is a touch:
# without that, 1 % more touches in passing are missed. Later, it may be a body that breathes.
MOST_RESTLESS = 20.0
# After a touch, the peak of two quiet seconds (a breath) replaces the peak from when the hand left.
LEAVING_FRAMES = 2 * SECOND_FRAMES

# Touched.
# Contact that is low and does not rise is what the hand has left: a fold, a material that creeps. Low: below
# this share of the touch's highest half second, less a light hand. Without this rule, a firm pad's
# touches are merged over six times as many pauses.
LOW_SHARE = 0.5
# It rises if it exceeds its lowest by this share of the same level. With 0.1, three more of the firm pad's
# pauses are merged. Light contact that rises so in a second does not become rest.
RISE_SHARE = 0.15
# What a light hand makes; more begins a touch at once. The network is asked about quiet frames with less; if
# it knows the pad, about all.
LIGHT_COUNTS = 60.0
# On a pad that the network knows, it decides what contact remains, unless the touch was a hug: without this,
# 3 % more of the robot's touches are split. What a hug leaves looks like a hand to it: with 1000, a firm 8x8
# pad keeps six more touches open.
HUG_COUNTS = 500.0
# A taxel is still if the means of its half seconds differ by at most this, its sway, or what noise explains,
# and its noise is at most what an untouched pad may have or a share of the load: a load with 2 % of noise is
# still. A touch is dated back to where its taxels begin to exceed rest by as much: without that, 3 % fewer
# touches of the breathing robot are right.
STILL_COUNTS = 1.0
STILL_SPREADS = 0.8
LOAD_NOISE = 0.03
# Low and still for two thirds of a second, a touch is over, unless the network sees a light one in them.
STILL_FRAMES = 2 * ASK_FRAMES
SETTLED_FRAMES = round(10 * FRAME_RATE_HZ)  # a load that has kept still as long becomes rest
LONGEST_FRAMES = round(600 * FRAME_RATE_HZ)  # a touch ends


class TouchSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When a touch begins and ends. The defaults were chosen by measurement: docs/sessions.md.

    onset_threshold: contact that begins a touch, in counts above the noise floor, summed over the pad; lower
    detects lighter touches and more false ones. Above the default, the network alone begins no touch.
    quiet_s: seconds of quiet that end a touch; longer than the lift-off between two strokes.
    """

    onset_threshold: Annotated[float, msgspec.Meta(ge=0.001, le=1000)] = ONSET_COUNTS
    quiet_s: Annotated[float, msgspec.Meta(ge=0.1, le=5.0)] = 0.8


@dataclass(frozen=True, slots=True)
class Onset:
    """A touch was detected; first_index is the grid frame at which it truly began."""

    first_index: int


@dataclass(frozen=True, slots=True)
class Release:
    """The touch is over; first_index and last_index are its first and last grid frame with contact."""

    first_index: int
    last_index: int
    reason: EndReason


@dataclass(slots=True)
class MeasuringRest:
    """Rest is not known yet."""


@dataclass(slots=True)
class Quiet:
    """Nothing touches the pad.

    frames: number of quiet frames, without those in maybe. peak: the highest contact in them. shifted_frames:
    for how many frames the pad has read less than at rest, or evenly more. unsteady_index: the last such
    frame, or the frame of the last calibration or release.
    """

    unsteady_index: int
    frames: int = 0
    peak: float = 0.0
    shifted_frames: int = 0


@dataclass(slots=True)
class Maybe:
    """Contact that may be a touch.

    quiet: the state before. since, last: the first frame, and the latest with enough contact. before: (64,)
    counts just after the first frames, when a baseline shift is over. moved, highest: the most movement and
    contact, in counts summed over the pad. touched: (64,) whether a taxel is above noise.
    """

    quiet: Quiet
    since: int
    last: int
    before: Taxels
    moved: float = 0.0
    highest: float = 0.0
    touched: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(TAXELS, np.bool_))


@dataclass(slots=True)
class Brief:
    """The latest rise of the untouched pad: its first and last frame, and its highest contact in counts."""

    first: int = -SECOND_FRAMES
    last: int = -SECOND_FRAMES
    highest: float = 0.0


@dataclass(slots=True)
class Touched:
    """An ongoing touch.

    first, last: the first frame, and the last with contact. next_ask: the frame at which the network, which
    saw a hand without contact, is asked again. highest_level: the largest contact of a half second.
    lowest_level: the least contact since `last`. still_frames: for how many frames the pad has kept still.
    """

    first: int
    last: int
    next_ask: int = 0
    highest_level: float = 0.0
    lowest_level: float = math.inf
    still_frames: int = 0


State: TypeAlias = MeasuringRest | Quiet | Maybe | Touched
Change: TypeAlias = Onset | Release | None


class TouchTracker:
    """Takes the pad's frames one by one and returns where touches begin and end.

    p_no_touch: None if no network knows "notouch". is_finer: whether the pad has more taxels than 8x8.
    baseline: what is known of the untouched pad; it does not change during a touch.
    """

    def __init__(
        self, settings: TouchSettings, p_no_touch: Question | None = None, *, is_finer: bool = False
    ) -> None:
        self.baseline = Baseline()
        self._settings = settings
        self._quiet_frames = round(settings.quiet_s * FRAME_RATE_HZ)
        self._release_counts = min(settings.onset_threshold, ONSET_COUNTS)
        self._network = NetworkCheck(
            None if p_no_touch is None else lambda frames: p_no_touch(frames, self.baseline.counts), is_finer
        )
        self._loose_wire = LooseWire()
        self._recent = LastSecond()
        self._state: State = MeasuringRest()
        self._brief = Brief()
        # The untouched pad's recent peak contact; the same before the present contact, which may be a hand's.
        self._restless = self._restless_before = 0.0
        self._index, self._sensor_ms = -1, 0.0

    @property
    def is_untouched(self) -> bool:
        """Whether the last hand left some seconds ago, so that what the pad reads is its own."""
        quiet = self._state.quiet if isinstance(self._state, Maybe) else self._state
        return isinstance(quiet, Quiet) and quiet.frames >= LEAVING_FRAMES

    @property
    def last_contact_index(self) -> int:
        """The current touch's last grid frame with contact, less the median's delay."""
        state = self._state
        if not isinstance(state, Touched) or state.last == self._index:
            return self._index
        return max(state.first, self._last_seen(state) - SMOOTH_FRAMES // 2)

    @property
    def loose_lines(self) -> tuple[str, ...]:
        """The rows and columns that jump while nothing touches the pad."""
        return self._loose_wire.lines

    def without_loose_wire(self, frames: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (..., 8, 8) counts without the jumps of a loose line, as the tracker itself sees them."""
        return self._loose_wire.take_out(frames, self.baseline.counts)

    def update(self, frame: GridFrame) -> Change:
        """Take the next grid frame; return the touch that it begins or ends."""
        release = self._restart(frame) if frame.restarted else None
        self._index, self._sensor_ms = frame.index, frame.sensor_ms
        self._recent.push(self.without_loose_wire(frame.pressure).reshape(TAXELS))
        if len(self._recent) < SMOOTH_FRAMES:
            return release
        match self._state:
            case MeasuringRest():
                if len(self._recent) >= CALIBRATION_FRAMES:
                    self._calibrate(Quiet(self._index))
                return release
            case Quiet() as quiet:
                return self._watch(quiet)
            case Maybe() as maybe:
                return self._weigh(maybe)
            case Touched() as touch:
                return self._hold(touch)

    def forget(self, reason: EndReason) -> Release | None:
        """End the touch, if one goes on, and measure rest again: it may be another pad."""
        release = self._end(self._state, reason) if isinstance(self._state, Touched) else None
        self._forget_rest()
        return release

    def _restart(self, frame: GridFrame) -> Release | None:
        """End the touch at a gap in the frames, and forget rest after a long one."""
        release = self._end(self._state, "gap") if isinstance(self._state, Touched) else None
        self._recent.clear()
        self._network.forget_answers()
        if not 0 < frame.sensor_ms - self._sensor_ms <= CHANGED_AFTER_MS:
            self._forget_rest()
        elif not isinstance(self._state, MeasuringRest):
            self._state = Quiet(self._index)
        return release

    def _forget_rest(self) -> None:
        self.baseline = Baseline()
        self._loose_wire = LooseWire()
        self._network.forget_rest()
        self._recent.clear()
        self._state = MeasuringRest()

    def _calibrate(self, quiet: Quiet, frames: int = CALIBRATION_FRAMES) -> None:
        """Take the last frames as rest; the state becomes quiet."""
        self.baseline.calibrate(self._recent.last(frames))
        self._network.forget_answers()
        quiet.shifted_frames, quiet.unsteady_index = 0, self._index
        self._state = quiet

    # Quiet.

    def _watch(self, quiet: Quiet) -> Change:
        self._look_for_loose_wire()
        smooth = self._smooth()
        rise = smooth - self.baseline.counts
        drift = drift_of(rise)
        contact = beyond_one_wire(self._above(rise - drift))
        if (brief := self._brief_touch(beyond_one_wire(self._above(rise)) if drift else contact)) is not None:
            return brief
        if contact >= self._onset_counts:
            self._state = Maybe(quiet, self._index, self._index, smooth)
            return self._weigh(self._state)
        self._restless *= RESTLESS_KEPT
        self._restless_before = self._restless_before if contact else self._restless
        self._learn_restless(contact)
        quiet.peak = max(quiet.peak, min(contact, MOST_RESTLESS))
        if quiet.frames == LEAVING_FRAMES:
            self._restless = quiet.peak
        quiet.frames += 1
        self.baseline.track(self._recent.last(1)[0])
        # The network would take drift for a still hand.
        sunken = beyond_one_wire(self._above(-rise))
        is_shifted = drift > MAX_DEVIATION_COUNTS or sunken >= self._settings.onset_threshold
        self._follow_rest(quiet, is_shifted=is_shifted)
        return self._ask_at_rest(quiet)

    def _learn_restless(self, peak: float) -> None:
        self._restless = max(self._restless, min(peak, MOST_RESTLESS))

    def _follow_rest(self, quiet: Quiet, *, is_shifted: bool) -> None:
        """Calibrate again if the pad reads less than at rest, or evenly more; otherwise learn its sway."""
        quiet.shifted_frames = quiet.shifted_frames + 1 if is_shifted else 0
        if is_shifted:
            quiet.unsteady_index = self._index
        if quiet.shifted_frames >= CALIBRATION_FRAMES:
            # Less: rest was calibrated under a hand or an object that is now gone. More: the supply changed.
            self._calibrate(quiet)
        elif self._is_time_to_check() and self._index - quiet.unsteady_index >= SECOND_FRAMES:
            older, newer = self._recent.halves()
            # What only rises may be a hand; a body that breathes falls as often.
            if newer.sum() <= older.sum():
                self.baseline.track_sway(np.abs(newer - older))

    def _ask_at_rest(self, quiet: Quiet) -> Onset | None:
        """Ask the network about a pad without contact: in some touches no taxel is above the noise."""
        if self._index % ASK_FRAMES or quiet.frames < CALIBRATION_FRAMES or not self._network.is_there:
            return None
        is_seen = self._network.begins_touch(self._recent.last(SECOND_FRAMES))
        may_begin = is_seen and self._settings.onset_threshold <= ONSET_COUNTS
        return self._begin(self._index - SECOND_FRAMES) if may_begin else None

    # Maybe.

    def _weigh(self, maybe: Maybe) -> Change:
        self._look_for_loose_wire()
        smooth = self._smooth()
        rise = smooth - self.baseline.counts
        above = self._above(rise - drift_of(rise))
        contact = beyond_one_wire(above)
        waited = self._index - maybe.since
        if waited < SMOOTH_FRAMES:
            maybe.before = smooth
        if contact >= self._onset_counts:
            maybe.last, maybe.touched = self._index, above > 0
        maybe.highest = max(maybe.highest, contact)
        off = smooth - maybe.before
        off -= np.sort(off)[TAXELS // 2]
        maybe.moved = max(maybe.moved, float(np.maximum(np.abs(off) - self.baseline.noise_floor, 0).sum()))

        movement = maybe.moved / RESTLESS_FACTOR
        may_breathe = waited > ASK_FRAMES and self._network.is_there
        is_sure = contact >= LIGHT_COUNTS or (movement >= MOST_RESTLESS and not may_breathe)
        if is_sure or self._is_light_touch(waited, is_moving=movement >= max(ONSET_COUNTS, self._restless)):
            return self._begin(self._first_frame(maybe))
        if waited and (brief := self._brief_touch(beyond_one_wire(self._above(rise)))) is not None:
            return brief
        if self._index - maybe.last >= CALIBRATION_FRAMES:
            self._learn_restless(maybe.highest)
            self._state = maybe.quiet
        elif waited >= SECOND_FRAMES and not self._is_rising():
            self._calibrate(maybe.quiet)
        return None

    def _is_light_touch(self, waited: int, *, is_moving: bool) -> bool:
        """Ask the network about light contact, sooner if it moves."""
        if is_moving and waited >= ASK_FRAMES:
            is_due = self._index % CHECK_FRAMES == 0
        else:
            is_due = waited == SECOND_FRAMES and self._network.is_there
        return is_due and self._network.is_below(NONE, self._recent.last(waited + 1 - SMOOTH_FRAMES))

    def _brief_touch(self, rise: float) -> Onset | None:
        """Ask the network about a rise that has gone: a light pat, or one that lifts the whole pad.

        Without this, 13 of 35 single pats of HAART are missed. rise: contact in counts, with what all taxels
        rose by.
        """
        brief, gone_frames = self._brief, CALIBRATION_FRAMES // 2
        if rise >= max(self._onset_counts, LOW_SHARE * brief.highest):
            if self._index - brief.last > gone_frames:
                brief.first = self._index
            brief.last, brief.highest = self._index, max(brief.highest, rise)
        elif self._index - brief.last == gone_frames:
            brief.highest = 0.0
            asked = self._recent.last(self._index - brief.first + SMOOTH_FRAMES - 1)
            if self._network.sees_touch(asked, TOUCH):
                return self._begin(brief.first, brief.last)
        return None

    def _first_frame(self, maybe: Maybe) -> int:
        """Return the first frame of the unbroken run up to the contact in which its taxels exceed rest."""
        drift = drift_of(maybe.before - self.baseline.counts)
        rest = self.baseline.counts[maybe.touched].mean() + drift
        before = self._recent.last(SECOND_FRAMES)[: maybe.since - self._index - 1, maybe.touched]
        above = before.mean(axis=1) - rest >= STILL_COUNTS
        return maybe.since - (len(above) if above.all() else int(above[::-1].argmin()))

    def _begin(self, first: int, last: int | None = None) -> Onset:
        """Begin a touch; last: its last frame with contact, if that is not the current one."""
        self._network.forget_answers()
        self._brief = Brief()
        self._restless = min(self._restless, self._restless_before)
        self._state = Touched(first, self._index if last is None else last)
        return Onset(first)

    # Touched.

    def _hold(self, touch: Touched) -> Release | None:
        quiet_frames = self._index - touch.last
        level = self._level(self._smooth())
        is_contact = self._is_contact(touch, level)
        if is_contact:
            touch.last, touch.lowest_level = self._index, level
        elif self._index - self._last_seen(touch) >= self._quiet_frames:
            if not self._sees_light_touch(touch, level, quiet_frames):
                return self._end_at_residue(touch, level)
            touch.next_ask = self._index + ASK_FRAMES
        elif self._quiet_frames > SECOND_FRAMES:
            # Wait for a `quiet_s` that is longer than the second checked below.
            touch.still_frames = 0
            self._network.forget_answers()
            return None
        if self._index - touch.first >= LONGEST_FRAMES:
            return self._end_at_new_rest(touch, "longest")
        if self._is_time_to_check(touch.first) and self._index - touch.first >= SECOND_FRAMES:
            return self._check_end(touch, may_ask=not is_contact or quiet_frames == 1)
        return None

    def _is_contact(self, touch: Touched, level: float) -> bool:
        """Whether the hand makes this contact, rather than having left it behind."""
        if self._is_time_to_check(touch.first):
            _, newer = self._recent.halves()
            touch.highest_level = max(touch.highest_level, self._level(newer))
        touch.lowest_level = min(touch.lowest_level, level)
        is_judged = touch.highest_level >= HUG_COUNTS or not self._network.knows_pad
        size = touch.highest_level - LIGHT_COUNTS
        is_low = is_judged and level < LOW_SHARE * size
        is_rising = level > touch.lowest_level + max(MOST_RESTLESS, RISE_SHARE * size)
        return level >= self._quiet_counts and (is_rising or not is_low)

    def _last_seen(self, touch: Touched) -> int:
        """Return the last frame with contact, or a later one if the network saw a hand since."""
        return max(touch.last, touch.next_ask - self._quiet_frames)

    def _level(self, pressure: Taxels) -> float:
        return float(self._above(pressure - self.baseline.counts).sum())

    def _sees_light_touch(self, touch: Touched, level: float, quiet_frames: int) -> bool:
        """Ask the network about the quiet frames; if `quiet_s` is short, about no others."""
        asked = self._recent.last(min(quiet_frames, STILL_FRAMES))
        is_light = level < LIGHT_COUNTS and touch.highest_level < HUG_COUNTS
        may_ask = (is_light or self._network.knows_pad) and len(asked) >= ASK_FRAMES
        return may_ask and self._network.sees_touch(asked, NONE)

    def _check_end(self, touch: Touched, *, may_ask: bool) -> Release | None:
        """End the touch if the pad shows that nobody touches it, even above its baseline.

        may_ask: whether to ask the network; not if contact has just returned, for which an answer may wait.
        """
        older, newer = self._recent.halves()
        change, rise = np.abs(newer - older), newer - self.baseline.counts
        is_still = self._is_still(change, self._recent.spread(), rise)
        touch.still_frames = touch.still_frames + CHECK_FRAMES if is_still else 0
        # The whole pad may have drifted by as much as its lightest quarter rose.
        drift = max(float(np.sort(rise)[TAXELS // 4]), 0.0)
        low = max(LOW_SHARE * touch.highest_level, LIGHT_COUNTS)
        if not is_still and float(self._above(rise - drift).sum()) > low:
            self._network.forget_answers()
        elif may_ask and (self._index - touch.first) % ASK_FRAMES == 0:
            self._network.follow_touch(self._recent.last(SECOND_FRAMES))

        # Low and still; only the network may see a light touch that keeps still.
        level = self._level(newer)
        is_left = level <= low and touch.still_frames >= STILL_FRAMES
        if is_left and level < LIGHT_COUNTS:
            is_left = not self._network.sees_touch(self._recent.last(SECOND_FRAMES), DOUBT)
        if is_left or self._network.ends_touch:
            over_frames = max(touch.still_frames, SECOND_FRAMES if self._network.ends_touch else 0)
            since = self._index - over_frames - SECOND_FRAMES // 2
            touch.last, touch.next_ask = max(touch.first, min(touch.last, since)), 0
            return self._end_at_new_rest(touch, "released")
        return self._end_at_new_rest(touch, "settled") if touch.still_frames >= SETTLED_FRAMES else None

    def _is_still(self, change: Taxels, spread: Taxels, rise: Taxels) -> bool:
        allowed = np.maximum(self.baseline.sway, STILL_SPREADS * spread)
        least = np.maximum(LOAD_NOISE * rise, STILL_COUNTS)
        noise = np.maximum(LOAD_NOISE * rise, MAX_DEVIATION_COUNTS)
        return bool((change <= np.maximum(allowed, least)).all() and (spread <= noise).all())

    def _end_at_residue(self, touch: Touched, level: float) -> Release:
        """End the touch; what it left above the baseline is the new rest."""
        is_rest = level < self._quiet_counts
        if not is_rest and self._network.sees_touch(self._recent.last(SECOND_FRAMES), TOUCH):
            # The network takes what is left for a hand, and would begin the touch again.
            self._network.forget_rest()
        release = self._end(touch, "released")
        if not is_rest:
            # A hand that leaves would be learned as noise.
            self.baseline.shift(self._recent.last(CALIBRATION_FRAMES))
        return release

    def _end_at_new_rest(self, touch: Touched, reason: EndReason) -> Release:
        """End the touch, and take the current readings as rest."""
        if reason != "released" or self._network.sees_touch(self._recent.last(SECOND_FRAMES), TOUCH):
            # The network takes the object there for a hand, and would begin the touch again.
            self._network.forget_rest()
        release = self._end(touch, reason)
        self._calibrate(Quiet(self._index), SECOND_FRAMES)
        self.baseline.track_sway(np.abs(np.subtract(*self._recent.halves())))
        frames = self._recent.last(SECOND_FRAMES)
        smooth = _median(frames[2:], frames[1:-1], frames[:-2])
        peak = max(map(beyond_one_wire, self._above(smooth - self.baseline.counts)))
        self._restless = min(peak, MOST_RESTLESS)
        return release

    def _end(self, touch: Touched, reason: EndReason) -> Release:
        release = Release(touch.first, self.last_contact_index, reason)
        self._network.forget_answers()
        self._state = Quiet(self._index)
        return release

    # What the pad shows.

    def _is_time_to_check(self, first: int = 0) -> bool:
        """In a touch, counted from its first frame, no answer is due then, unless the marks were moved."""
        return (self._index - first) % CHECK_FRAMES == 0 and len(self._recent) == SECOND_FRAMES

    @property
    def _onset_counts(self) -> float:
        return max(self._settings.onset_threshold, RESTLESS_FACTOR * self._restless)

    @property
    def _quiet_counts(self) -> float:
        """Contact below which nothing touches the pad."""
        return max(self._release_counts, self._restless)

    def _is_rising(self) -> bool:
        """Whether contact has risen by `RISE_SHARE` within the last second, as in a slow press."""
        older, newer = (self._above(half - self.baseline.counts).sum() for half in self._recent.halves())
        return bool(newer > (1 + RISE_SHARE) * older)

    def _smooth(self) -> Taxels:
        return _median(*self._recent.last(SMOOTH_FRAMES))

    def _above(self, rise: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return by how much (..., 64) counts exceed the noise floor."""
        above: NDArray[np.float32] = np.maximum(rise - self.baseline.noise_floor, 0)
        return above

    def _look_for_loose_wire(self) -> None:
        is_time = self._index % CHECK_FRAMES == 0 and len(self._recent) >= LOOK_FRAMES
        if is_time and self._loose_wire.look(self._recent.last(LOOK_FRAMES)):
            self._network.forget_answers()


def drift_of(rise: Taxels) -> float:
    """Return the counts by which at least half of the taxels rose: drift, as a hand lifts some much more.

    Without this, 8 instead of 1 of the third study's 17 recordings at rest begin a touch, if the pad rests
    high.
    """
    return max(float(np.sort(rise)[TAXELS // 2]), 0.0)


def beyond_one_wire(above: Taxels) -> float:
    """Sum (64,) counts, without what a loose wire may lift of the strongest row or column."""
    sums = LINES.dot(above).tolist()
    return float(sum(sums[:ROWS]) - min(max(sums), WIRE_COUNTS))


def _median(a: NDArray[np.float32], b: NDArray[np.float32], c: NDArray[np.float32]) -> NDArray[np.float32]:
    # Sorting takes twice as long.
    median: NDArray[np.float32] = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
    return median
