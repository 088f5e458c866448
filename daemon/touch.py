"""When a touch begins and when it ends.

Contact is pressure above the baseline and above each taxel's noise floor, summed over the pad: a light
stroke is hardly above noise in any one taxel, but in many at once. A loose wire lifts a whole row by a few
counts, as a light touch does; a touch lifts other rows too, or that one by more, so it begins on the contact
beyond one row's or column's first counts. Firm contact begins a touch at once. Light contact may also be a
baseline that shifted or a pad that wobbles: it begins a touch when it moves on and the network sees one.

A touch ends when contact has been gone for `quiet_s`, or when the pad shows that nobody touches it, whatever
it reads (daemon/pad/held.py). What it reads then becomes its baseline. The figures behind the numbers are in
docs/touch.md.
"""

from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.daemon.events import EndReason
from touchd.daemon.pad.baseline import SECOND_FRAMES, TAXELS, Baseline, LastSecond, Taxels
from touchd.daemon.pad.held import END_STRIDE_FRAMES, HeldTouch
from touchd.daemon.pad.light import STEP_FRAMES, LightContact, beyond_one_wire, is_in_common
from touchd.daemon.pad.sight import ASK_FRAMES, NoTouch, Sight
from touchd.daemon.pad.wire import LOOK_FRAMES, LooseWire
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.pad.grid import GridFrame

# A median over three frames halves the noise and lets no single broken frame through, for one frame's delay.
SMOOTH_FRAMES = 3
CALIBRATION_FRAMES = 27
# Up to this threshold the network may begin a touch that has too little contact.
NOTICED_COUNTS = 4.0
# Contact below which the pad is quiet, in the same counts.
RELEASE_COUNTS = 4.0
# A load that has kept still for ten seconds is the pad's new rest.
SETTLED_FRAMES = round(10 * FRAME_RATE_HZ)
# A touch that goes on for ten minutes is ended, and what lies on the pad is its new rest.
LONGEST_FRAMES = round(600 * FRAME_RATE_HZ)
# A pad silent for longer, or restarted, may have been moved or changed: it is calibrated anew.
CHANGED_AFTER_MS = 2000.0

# Contact that only a hand makes: this much, or this many times the untouched pad's recent peak.
FIRM_COUNTS = 60.0
FIRM_RESTLESS = 3.0
# A hand goes on moving, by so many counts summed over the pad.
MOVED_COUNTS = 6.0
SURE_MOVEMENT = 4.0
# Later movement may be a breathing body's.
SURE_FRAMES = 9
LEAST_ASKED_FRAMES = 18
ASK_LIGHT_FRAMES = 9
NO_TOUCH_MOVING = 0.5
NO_TOUCH_STILL = 0.3
# Contact must exceed the untouched pad's recent peak by half; the peak is forgotten in 20 seconds.
RESTLESS_FACTOR = 1.5
RESTLESS_KEPT = 0.999
# What was measured while a hand left is forgotten after two quiet seconds, in which a body breathes once.
LEAVING_FRAMES = 108

# The network is asked while nothing touches the pad about its last two thirds of a second, for some touches
# are in no single taxel above the noise; else about its last second.
GLANCE_FRAMES = 36
ABOVE_AND_BELOW = np.array([[1], [-1]], np.float32)


class TouchSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a touch is told from a pad at rest. The defaults were chosen by measurement: docs/touch.md.

    onset_threshold: contact that begins a touch, in counts summed over the pad above each taxel's noise
        floor; lower notices lighter touches and raises more false alarms. Above the default, none begins
        because the network sees it.
    quiet_s: a touch ends after this much quiet; longer than the lift-off between two strokes. Seconds.
    """

    onset_threshold: Annotated[float, msgspec.Meta(ge=0.001, le=1000)] = NOTICED_COUNTS
    quiet_s: Annotated[float, msgspec.Meta(ge=0.1, le=5.0)] = 0.8


@dataclass(frozen=True, slots=True)
class Onset:
    """A touch has been noticed; first_index is the grid frame at which it truly began."""

    first_index: int


@dataclass(frozen=True, slots=True)
class Release:
    """The touch is over; first_index and last_index are its first and last grid frame with contact."""

    first_index: int
    last_index: int
    reason: EndReason


class TouchTracker:
    """Follows the pad frame by frame and says when a touch begins and ends.

    no_touch: the network's probability that nothing touches the pad in (T, 8, 8) counts.
    """

    def __init__(self, settings: TouchSettings, no_touch: NoTouch | None = None) -> None:
        self._baseline = Baseline()
        self._recent = LastSecond()
        self._wire = LooseWire()
        self._index = -1
        self._sensor_ms = 0.0
        self._sunken_frames = 0
        self._unsteady_index = 0
        self._restless = self._restless_since = 0.0
        self._watched_frames = 0
        self._rest_activity = 0.0
        self._light: LightContact | None = None
        self._held: HeldTouch | None = None
        self._sight = Sight(no_touch)
        self._settings = settings
        self._quiet_frames = round(settings.quiet_s * FRAME_RATE_HZ)
        self._release_counts = min(settings.onset_threshold, RELEASE_COUNTS)

    @property
    def baseline(self) -> Baseline:
        """What is known of the untouched pad; it stays the same during a touch."""
        return self._baseline

    @property
    def last_contact_index(self) -> int:
        """The current touch's last grid frame with contact; the median delays it."""
        if self._held is None or self._held.last == self._index:
            return self._index
        return max(self._held.first, self._held.last - SMOOTH_FRAMES // 2)

    @property
    def is_disturbed(self) -> bool:
        """Whether the untouched pad is so noisy that light touches go unnoticed."""
        return self._baseline.is_disturbed

    @property
    def loose_lines(self) -> tuple[str, ...]:
        """The rows and columns that jump while nothing touches the pad."""
        return self._wire.lines

    def without_loose_wire(self, frames: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (..., 8, 8) counts without what a loose line jumps, as the tracker itself sees them."""
        return self._wire.take_out(frames, self._baseline.counts)

    def update(self, frame: GridFrame) -> Onset | Release | None:
        """Take the next grid frame; return what it changed. The first half second calibrates the baseline."""
        release = None
        if frame.restarted:
            release = self._end("gap")
            self._clear()
            if not 0 < frame.sensor_ms - self._sensor_ms <= CHANGED_AFTER_MS:
                self._forget_rest()
        self._index, self._sensor_ms = frame.index, frame.sensor_ms
        self._recent.push(self.without_loose_wire(frame.pressure).reshape(TAXELS))
        if not self._baseline.is_known:
            if len(self._recent) == CALIBRATION_FRAMES:
                self._calibrate()
            return release
        if len(self._recent) < SMOOTH_FRAMES:
            return release
        smooth = _median(*self._recent.last(SMOOTH_FRAMES))
        return self._watch(smooth) if self._held is None else self._hold(smooth, self._held)

    def forget(self, reason: EndReason) -> Release | None:
        """End the touch, if one goes on, and calibrate anew from what comes: it may be another pad."""
        release = self._end(reason)
        self._forget_rest()
        self._clear()
        return release

    def _watch(self, smooth: Taxels) -> Onset | None:
        is_time = self._index % END_STRIDE_FRAMES == 0 and len(self._recent) >= LOOK_FRAMES
        if is_time and self._wire.look(self._recent.last(LOOK_FRAMES)):
            self._sight.forget_looks()
        rise = smooth - self._baseline.counts
        # The same for what lies above rest and for what lies below.
        both = np.maximum(ABOVE_AND_BELOW * rise - self._baseline.noise_floor, 0)
        above = both[0]
        contact, sunken = beyond_one_wire(both)
        if self._light is None and contact >= self._onset_counts and is_in_common(rise):
            contact = 0.0
        if contact >= self._onset_counts or self._light is not None:
            return self._weigh_light(smooth, above, contact)
        self._restless = max(self._restless * RESTLESS_KEPT, contact)
        self._restless_since = max(self._restless_since, contact) if self._watched_frames else contact
        if self._watched_frames == LEAVING_FRAMES:
            self._restless = self._restless_since
        self._baseline.track(self._recent.last(1)[0])
        is_sunken = sunken >= self._settings.onset_threshold
        self._sunken_frames = self._sunken_frames + 1 if is_sunken else 0
        if is_sunken:
            self._unsteady_index = self._index
        if self._sunken_frames >= CALIBRATION_FRAMES:
            # Pressure does not go below rest: it was calibrated under a hand or an object that is now gone.
            self._calibrate()
        elif self._is_time_to_look and self._index - self._unsteady_index >= SECOND_FRAMES:
            older, newer = self._recent.halves()
            change = np.abs(newer - older)
            self._baseline.track_sway(change)
            activity = float(change.sum() + self._recent.spread().sum())
            self._rest_activity = max(self._rest_activity * 0.995, activity)
        return self._glance()

    def _glance(self) -> Onset | None:
        """Ask the network about a pad without contact."""
        self._watched_frames += 1
        if self._index % ASK_FRAMES or self._watched_frames < GLANCE_FRAMES or not self._sight.is_there:
            return None
        is_seen = self._sight.look_at_rest(self._recent.last(GLANCE_FRAMES))
        if not is_seen or self._settings.onset_threshold > NOTICED_COUNTS:
            return None
        self._sight.forget_looks()
        self._held = HeldTouch(self._index - GLANCE_FRAMES - ASK_FRAMES, self._index)
        return Onset(self._held.first)

    @property
    def _is_time_to_look(self) -> bool:
        return self._index % END_STRIDE_FRAMES == 0 and len(self._recent) == SECOND_FRAMES

    @property
    def _onset_counts(self) -> float:
        return max(self._settings.onset_threshold, RESTLESS_FACTOR * self._restless)

    def _weigh_light(self, smooth: Taxels, above: Taxels, contact: float) -> Onset | None:
        """Tell a touch from a shifted baseline, which stands still, and a wobble, which the network knows."""
        light = self._light
        if light is None:
            light = self._light = LightContact(self._index, smooth)
        light.follow(self._index, smooth, above, contact, self._onset_counts, self._baseline)
        waited = self._index - light.since
        movement = light.moved / max(MOVED_COUNTS, RESTLESS_FACTOR * self._restless)
        is_firm = contact >= max(FIRM_COUNTS, FIRM_RESTLESS * self._restless)
        may_breathe = waited > SURE_FRAMES and self._sight.is_there
        is_sure = is_firm or (movement >= SURE_MOVEMENT and not may_breathe)
        if is_sure or self._is_light_touch(waited, movement):
            self._light = None
            self._sight.forget_looks()
            self._held = HeldTouch(light.began(self._index, self._recent, self._baseline), self._index)
            return Onset(self._held.first)
        if self._index - light.last >= CALIBRATION_FRAMES:
            self._restless = max(self._restless, light.highest)
            self._light = None
        elif waited >= SECOND_FRAMES:
            self._calibrate()
        return None

    def _is_light_touch(self, waited: int, movement: float) -> bool:
        """Ask the network about light contact, sooner if it moves; on some disturbed pads it cannot tell."""
        if movement >= 1.0 and waited >= LEAST_ASKED_FRAMES:
            is_due, least = self._index % ASK_LIGHT_FRAMES == 0, NO_TOUCH_MOVING
        else:
            is_due, least = waited == SECOND_FRAMES and self._sight.is_there, NO_TOUCH_STILL
        if not is_due or (self.is_disturbed and self._sight.is_lost):
            return is_due
        return self._sight.is_below(least, self._recent.last(waited - STEP_FRAMES))

    def _hold(self, smooth: Taxels, held: HeldTouch) -> Release | None:
        above = np.maximum(smooth - self._baseline.counts - self._baseline.noise_floor, 0)
        if float(above.sum()) >= max(self._release_counts, self._restless):
            held.touched(self._index, self._sight)
        elif (quiet_frames := self._index - held.last) >= self._quiet_frames:
            # About the quiet alone, where `quiet_s` is short.
            asked = self._recent.last(min(quiet_frames, GLANCE_FRAMES))
            if len(asked) < LEAST_ASKED_FRAMES or not self._sight.sees_touch(asked, NO_TOUCH_STILL):
                return self._end("released")
            held.last = self._index - self._quiet_frames + ASK_FRAMES
        if self._index - held.first >= LONGEST_FRAMES:
            return self._take_for_rest(held, "longest")
        if self._is_time_to_look and self._index - held.first >= SECOND_FRAMES:
            return self._look_for_end(held)
        return None

    def _look_for_end(self, held: HeldTouch) -> Release | None:
        """End the touch when the pad shows that nobody touches it, whatever it reads."""
        held.look(self._index, self._recent, self._baseline, self._sight, self._rest_activity)
        # Without contact a quiet time that is longer than this look is waited for.
        is_quiet = held.last < self._index and self._quiet_frames > SECOND_FRAMES
        if not is_quiet and held.is_over(self._recent, self._sight):
            return self._take_for_rest(held, "released")
        return self._take_for_rest(held, "settled") if held.still_frames >= SETTLED_FRAMES else None

    def _take_for_rest(self, held: HeldTouch, reason: EndReason) -> Release | None:
        """End the touch, and take the current readings as rest."""
        if reason == "released":
            held.last = held.over_since(self._index, self._sight)
        if reason != "released" or self._sight.sees_touch(self._recent.last(SECOND_FRAMES)):
            # The network takes what lies there for a hand, and would begin the touch anew.
            self._sight.forget_rest()
        release = self._end(reason)
        self._calibrate(SECOND_FRAMES)
        older, newer = self._recent.halves()
        self._baseline.track_sway(np.abs(newer - older))
        frames = self._recent.last(SECOND_FRAMES)
        smooth = _median(frames[2:], frames[1:-1], frames[:-2])
        above = np.maximum(smooth - self._baseline.counts - self._baseline.noise_floor, 0)
        self._restless = max(beyond_one_wire(above))
        return release

    def _calibrate(self, frames: int = CALIBRATION_FRAMES) -> None:
        self._baseline.calibrate(self._recent.last(frames))
        self._sunken_frames = 0
        self._unsteady_index = self._index
        self._light = None

    def _forget_rest(self) -> None:
        self._baseline = Baseline()
        self._wire = LooseWire()
        self._sight.forget_rest()

    def _clear(self) -> None:
        self._recent.clear()
        self._sight.forget_looks()
        self._sunken_frames = self._watched_frames = 0
        self._light = None

    def _end(self, reason: EndReason) -> Release | None:
        if self._held is None:
            return None
        release = Release(self._held.first, self.last_contact_index, reason)
        self._held = None
        self._watched_frames = 0
        self._sight.forget_looks()
        return release


def _median(a: Taxels, b: Taxels, c: Taxels) -> Taxels:
    median: Taxels = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
    return median
