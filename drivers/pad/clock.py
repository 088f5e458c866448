"""Dates each frame, by the pad's clock or by its arrival.

A frame is on time if its clock is 1 to 250 ms after that of the last accepted one (modulo 2^32, so the wrap
after 49.7 days needs no special case). A frame that repeats the last clock is a duplicate. Any other is held:
it may be damaged in a way the checksum does not detect, or be the first after a restart, a gap or the start.
The next frame decides: if it is on time for the clock followed so far, the held one is refused; if it is on
time for the held one, both are delivered, and the new clock is followed.

If a clock that was followed for a quarter of a second steps back, the board has restarted. Its clock is then
shifted to continue from the last frame before the restart, by the time between their arrivals: a touch may
go on, and rest stays known. A clock that jumps ahead is delivered unchanged.
"""

import math
from collections import deque

from touchd.drivers.frame import CLOCK_MODULUS, Counts, Frame, ProtocolCounts, ms_between

# What a unit of a pad's clock counts, in milliseconds; "none" is a pad without a clock.
UNITS_MS = {"none": 0.0, "ms": 1.0, "us": 0.001, "s": 1000.0}
# The longest step from one frame to the next. Below 256 ms: a flipped bit that the checksum cannot see moves
# the clock by at least that.
MAX_STEP_S = 0.25


class PadClock:
    """Dates a parser's frames, refuses those whose clock cannot be right, and counts these and restarts.

    unit: what the pad's clock counts, a key of UNITS_MS. dates_frames: whether the pad's clock dated the last
    frame; then it does not matter when frames are read.
    """

    def __init__(self, counts: ProtocolCounts, unit: str) -> None:
        self._counts = counts
        self._unit_ms = UNITS_MS[unit]
        self.dates_frames = False
        self._arrivals = ArrivalClock()
        self._held: Frame | None = None
        # Arrival of the first frame of the clock that is followed.
        self._since_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Forget the clock: the port was reopened, and may lead to another pad."""
        self._last: Frame | None = None
        # Added to the clock since the last restart.
        self._ahead_ms = 0
        self._refuse_held()
        self._arrivals.reset()

    def date(self, stamp: float | None, host_s: float, pressure: Counts) -> list[Frame]:
        """Return what can be delivered now: nothing, this frame, or the held frame that it confirms and this.

        stamp: the frame's clock as sent, None for a frame without one.
        """
        self.dates_frames = stamp is not None and self._unit_ms > 0
        if stamp is None or not self.dates_frames:
            return [Frame(self._arrivals.stamp_ms(host_s), host_s, pressure)]
        if not math.isfinite(sent_ms := stamp * self._unit_ms):
            self._counts.bad_time += 1
            return []
        frame = Frame(round(sent_ms) % CLOCK_MODULUS, host_s, pressure)
        last, held = self._last, self._held
        if last is not None and _steps_on(last, frame):
            self._refuse_held()
            return self._deliver([frame])
        if any(each is not None and each.sensor_ms == frame.sensor_ms for each in (last, held)):
            self._counts.duplicates += 1
            return []
        if held is not None and _steps_on(held, frame):
            self._held = None
            self._follow(held)
            return self._deliver([held, frame])
        self._refuse_held()
        self._held = frame
        return []

    def _follow(self, first: Frame) -> None:
        """Follow another clock from this frame on; after a restart, shift it by the frames' arrivals."""
        last, since_s, self._since_s = self._last, self._since_s, first.host_s
        if last is None:
            return
        is_back = ms_between(last.sensor_ms, first.sensor_ms) < 0
        if is_back and first.host_s - since_s >= MAX_STEP_S:
            later_ms = max(1, round(1000 * (first.host_s - last.host_s)))
            self._ahead_ms += last.sensor_ms + later_ms - first.sensor_ms
            self._counts.restarts += 1

    def _deliver(self, run: list[Frame]) -> list[Frame]:
        self._last = run[-1]
        if not self._ahead_ms:
            return run
        return [Frame((f.sensor_ms + self._ahead_ms) % CLOCK_MODULUS, f.host_s, f.pressure) for f in run]

    def _refuse_held(self) -> None:
        self._counts.bad_time += self._held is not None
        self._held = None


def _steps_on(earlier: Frame, later: Frame) -> bool:
    return 0 < (later.sensor_ms - earlier.sensor_ms) % CLOCK_MODULUS <= 1000 * MAX_STEP_S


# The pad's period is the mean step of this many arrivals.
ARRIVALS = 54
# Share of a frame's arrival error that moves its stamp: a jitter of 16 ms (a USB adapter's) becomes 1.6 ms.
PHASE_GAIN = 0.1


class ArrivalClock:
    """Stamps frames of a pad without a clock by their arrival, with the jitter smoothed."""

    def __init__(self) -> None:
        self._last_ms = 0
        self._dated_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Restart with the next frame."""
        self._arrivals_s = deque[float](maxlen=ARRIVALS)

    def stamp_ms(self, host_s: float) -> int:
        """Return the stamp (uint32 ms) of a frame that arrived at `host_s`; it never falls."""
        if not self._arrivals_s or host_s - self._arrivals_s[-1] > MAX_STEP_S:
            self.reset()
            self._dated_s = host_s
        else:
            expected_s = self._dated_s + (host_s - self._arrivals_s[0]) / len(self._arrivals_s)
            self._dated_s = expected_s + PHASE_GAIN * (host_s - expected_s)
        self._arrivals_s.append(host_s)
        self._last_ms = max(self._last_ms, round(1000 * self._dated_s))
        return self._last_ms % CLOCK_MODULUS
