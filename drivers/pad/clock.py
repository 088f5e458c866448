"""Dates each frame: by the pad's clock if that is plausible, otherwise by arrival.

A clock is taken as milliseconds until three windows of half a second show what it counts. If that agrees with
arrival in milliseconds, microseconds or seconds, the clock is used in that unit. If it agrees with the pad's
stated rate, it is used in milliseconds, for a recording may be played faster. Any other number is not used: a
frame number, an index, a temperature; after half a second if it stands still from the start. This holds until
the port is opened again.

A frame is on time if its clock is 1 to 250 ms after that of the last accepted one (modulo 2^32, so the wrap
after 49.7 days needs no special case). A frame that repeats the last clock is a duplicate. Any other is held:
it may be damaged in a way the checksum does not see, or be the first after a reboot, a long gap or the start.
A later frame decides:

- if the next frame is on time for the clock followed so far, the held ones were damaged and are refused;
- if a later frame is 1 to 250 ms after a held one, those two show the sensor's new clock; they are delivered
  in order, and the other held ones are refused.

So a real reset delays the first frame by one frame time and loses none, even with damaged frames in between.
A restart within 250 ms of the last one cannot be detected.

If a clock that was followed for a quarter of a second steps back, the board has restarted. Its frames are
then dated on from the last frame before, by how much later they arrived: a touch may go on, and rest stays
known. A clock that also jumps ahead, as when two boards send on one line, is delivered as it is.
"""

import math
from collections import deque
from dataclasses import dataclass

from touchd.drivers.frame import CLOCK_MODULUS, Counts, Frame
from touchd.drivers.pad.protocol_counts import ProtocolCounts

# The units in which a clock may count, in milliseconds.
UNITS_MS = (1.0, 0.001, 1000.0)
# A window's rate may be off by this share: frames come late, while quartz clocks differ by far less. Windows
# whose rates differ by more do not agree; a stall or a flood makes them differ.
CLOSE = 0.2
# A window of arrival, and how many must agree. After a gap longer than a window, a new one begins: the line,
# or the daemon, was held up.
WINDOW_S, WINDOWS = 0.5, 3
# A rate is measured over five frames or more. If five frames in a row come after two periods or more, a pad
# without a clock is slower than stated: without this rule, the stamps of a pad of 8 to 12 frames a second
# have gaps, in which touches end.
FEW_FRAMES = 5
NOT_USED = "; it is not used, and frames are dated by their arrival"

# The longest step from one frame to the next. Below 256 ms: a flipped bit that the checksum cannot see moves
# the clock by at least that.
MAX_STEP_S = 0.25
MAX_HELD = 8
# A clock that steps back after it was followed for MAX_STEP_S has restarted, unless it jumped ahead within
# this time.
LATELY_S = 60.0


class FrameClock:
    """Dates a parser's frames and refuses those whose clock cannot be right.

    rate_hz: the pad's stated rate. note: why the pad's clock is not used, "" where it is.
    """

    def __init__(self, counts: ProtocolCounts, rate_hz: float) -> None:
        self.note = ""
        self.counts = counts
        self._check = ClockCheck(counts)
        self._arrivals = ArrivalClock(rate_hz)
        self._rate_hz = rate_hz
        self.reset()

    def reset(self) -> None:
        """Forget the clock: the port was reopened, and may lead to another pad."""
        self._check.reset()
        self._arrivals.reset()
        self._unit_ms: float | None = UNITS_MS[0]
        self._is_chosen = False
        self._windows: deque[_Window] = deque(maxlen=WINDOWS)
        self._window: _Window | None = None

    @property
    def dates_frames(self) -> bool:
        """Whether frames are dated by the pad's clock, so that it does not matter when they are read."""
        return self._is_chosen and self._unit_ms is not None

    def is_on_time(self, stamp: float) -> bool:
        """Whether a frame with that clock agrees with the clock followed so far, if it is used."""
        return self._unit_ms is None or self._check.is_on_time(_as_ms(stamp, self._unit_ms))

    def judge(self, stamp: float | None, host_s: float, pressure: Counts) -> list[Frame]:
        """Return what can be delivered now: nothing, this frame, or this frame after held ones it confirms.

        stamp: the frame's clock as sent, None for a pad without one.
        """
        if stamp is None or not math.isfinite(stamp * max(UNITS_MS)):
            return [Frame(self._arrivals.stamp_ms(host_s), host_s, pressure)]
        if not self._is_chosen:
            self._look(stamp, host_s)
        if not self._is_chosen and stamp % 1:
            # A clock with a fraction does not count milliseconds.
            self._unit_ms = None
        if self._unit_ms is None:
            return [Frame(self._arrivals.stamp_ms(host_s), host_s, pressure)]
        delivered = self._check.judge(Frame(_as_ms(stamp, self._unit_ms), host_s, pressure))
        if self._window is not None:
            self._window.delivered += len(delivered)
        return delivered

    def _look(self, stamp: float, host_s: float) -> None:
        """Compare the clock with the frames' arrival; choose its unit once there is enough evidence."""
        window = self._window
        if window is None or host_s - window.last_s > WINDOW_S:
            self._window = _Window(stamp, host_s, stamp, host_s)
            return
        window.frames += 1
        window.standing += stamp <= window.last
        window.last, window.last_s = stamp, host_s
        if window.last_s - window.first_s < WINDOW_S or window.frames < FEW_FRAMES:
            return
        self._windows.append(window)
        self._window = _Window(stamp, host_s, stamp, host_s)
        # Until it is known that a number stands still, all frames are refused as duplicates. Half of them may
        # be duplicates: a line may send each frame twice.
        if len(self._windows) == WINDOWS or 4 * window.standing > 3 * window.frames:
            self._choose()

    def _choose(self) -> None:
        """Use the clock in the unit that the windows show, or not at all, if they show anything."""
        # Counts of the clock in a second of arrival, and from frame to frame.
        rates = sorted((each.last - each.first) / (each.last_s - each.first_s) for each in self._windows)
        steps = sorted((each.last - each.first) / each.frames for each in self._windows)
        stands = any(window.standing > window.frames // 4 for window in self._windows)
        if stands or rates[-1] >= (1 + CLOSE) * rates[0]:
            if all(2 * w.delivered < w.frames for w in self._windows):
                self._use(None, f"the pad's clock stands still or jumps{NOT_USED}")
            return
        rate, step = rates[len(rates) // 2], steps[len(steps) // 2]
        units_ms = [unit_ms for unit_ms in UNITS_MS if abs(rate * unit_ms / 1000 - 1) <= CLOSE]
        if units_ms:
            self._use(units_ms[0])
        elif abs(1000 / step / self._rate_hz - 1) <= CLOSE:
            self._use(UNITS_MS[0])
        elif abs(step - 1) <= CLOSE:
            # It numbers the frames.
            self._use(None)
        else:
            what = "neither milliseconds, microseconds nor seconds"
            self._use(None, f"the pad's clock counts {rate:.0f} in a second, {what}{NOT_USED}")

    def _use(self, unit_ms: float | None, note: str = "") -> None:
        if unit_ms != self._unit_ms:
            self._check.reset()
        self._unit_ms, self.note, self._is_chosen, self._window = unit_ms, note, True, None


@dataclass
class _Window:
    """Clock and arrival at its first and last frame, and counts of the frames after the first.

    standing: frames whose clock did not rise. delivered: frames that were passed on.
    """

    first: float
    first_s: float
    last: float
    last_s: float
    frames: int = 0
    standing: int = 0
    delivered: int = 0


def _as_ms(stamp: float, unit_ms: float) -> int:
    return round(stamp * unit_ms) % CLOCK_MODULUS


class ClockCheck:
    """Judges each well-formed frame by its clock; counts what it refuses, and restarts, in `counts`."""

    def __init__(self, counts: ProtocolCounts) -> None:
        self._counts = counts
        self._held: list[Frame] = []
        # When the clock that is followed was first seen.
        self._since_s = 0.0
        self._jumped_s = -math.inf
        self.reset()

    def reset(self) -> None:
        """Forget the clock: the port was reopened, and the sensor may have restarted."""
        self._last: Frame | None = None
        # What to add to the clock after restarts.
        self._ahead_ms = 0
        self._refuse_held()

    def is_on_time(self, sensor_ms: int) -> bool:
        """Whether a frame of that time agrees with the clock followed so far."""
        return self._last is not None and _steps_on(self._last.sensor_ms, sensor_ms)

    def judge(self, frame: Frame) -> list[Frame]:
        """Return what can be delivered now: nothing, this frame, or held ones it confirms and this."""
        now_ms = frame.sensor_ms
        if self.is_on_time(now_ms):
            self._refuse_held()
            return self._deliver([frame])
        is_last = self._last is not None and now_ms == self._last.sensor_ms
        if is_last or any(now_ms == held.sensor_ms for held in self._held):
            self._counts.duplicates += 1
            return []
        places = [place for place, held in enumerate(self._held) if _steps_on(held.sensor_ms, now_ms)]
        if places:
            before = self._held.pop(places[-1])
            self._refuse_held()
            self._follow(before)
            return self._deliver([before, frame])
        self._held.append(frame)
        if len(self._held) > MAX_HELD:
            del self._held[0]
            self._counts.bad_time += 1
        return []

    def _follow(self, first: Frame) -> None:
        """Follow another clock from this frame on; after a restart, date it by arrival."""
        last, since_s, self._since_s = self._last, self._since_s, first.host_s
        if last is None:
            return
        if (first.sensor_ms - last.sensor_ms) % CLOCK_MODULUS < CLOCK_MODULUS // 2:
            self._jumped_s = first.host_s
        elif first.host_s - since_s >= MAX_STEP_S and first.host_s - self._jumped_s >= LATELY_S:
            later_ms = max(1, round(1000 * (first.host_s - last.host_s)))
            self._ahead_ms += last.sensor_ms + later_ms - first.sensor_ms
            self._counts.restarted()

    def _deliver(self, run: list[Frame]) -> list[Frame]:
        self._last = run[-1]
        if not self._ahead_ms:
            return run
        return [Frame((f.sensor_ms + self._ahead_ms) % CLOCK_MODULUS, f.host_s, f.pressure) for f in run]

    def _refuse_held(self) -> None:
        self._counts.bad_time += len(self._held)
        self._held.clear()


def _steps_on(earlier_ms: int, later_ms: int) -> bool:
    return 0 < (later_ms - earlier_ms) % CLOCK_MODULUS <= 1000 * MAX_STEP_S


# Phase and period follow by these shares of a frame's arrival error. A jitter of 16 ms (a USB adapter's)
# becomes 1.6 ms; a pad 5 % off its stated rate is followed within a second.
PHASE_GAIN = 0.1
PERIOD_GAIN = 0.005
# Frames that flood in are stamped a millisecond apart; the clock restarts once it leads by this much.
AHEAD_MS = 1000


class ArrivalClock:
    """Stamps frames of a pad without a clock by their arrival; a phase-locked loop smooths the jitter.

    rate_hz: the pad's rate, as far as it is known. A frame more than MAX_STEP_S late resets it.
    """

    def __init__(self, rate_hz: float) -> None:
        self._stated_s = 1 / rate_hz
        self._last_ms = 0
        self.reset()

    def reset(self) -> None:
        """Restart with the next frame."""
        self._period_s = self._stated_s
        self._expected_s: float | None = None
        self._arrived_s, self._slow_s = math.inf, list[float]()

    def stamp_ms(self, host_s: float) -> int:
        """Return the stamp (uint32 ms) of a frame that arrived at `host_s`; it falls only after a flood."""
        step_s, self._arrived_s = host_s - self._arrived_s, host_s
        self._slow_s = [*self._slow_s, step_s] if step_s >= 2 * self._period_s else []
        if len(self._slow_s) == FEW_FRAMES:
            self._period_s, self._expected_s = min(self._slow_s), None
        expected_s = self._expected_s
        if expected_s is None or abs(host_s - expected_s) > MAX_STEP_S:
            expected_s = host_s
        else:
            off_s = host_s - expected_s
            expected_s += PHASE_GAIN * off_s
            period_s = self._period_s + PERIOD_GAIN * off_s
            self._period_s = min(max(period_s, self._stated_s / 4), MAX_STEP_S)
        self._expected_s = expected_s + self._period_s
        now_ms = round(1000 * expected_s)
        is_ahead = self._last_ms - now_ms > AHEAD_MS
        self._last_ms = now_ms if is_ahead else max(self._last_ms + 1, now_ms)
        return self._last_ms % CLOCK_MODULUS
