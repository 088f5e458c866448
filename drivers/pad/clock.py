"""Which frames agree with the sensor's clock, how a reset of that clock is told from a damaged frame, and a
clock for pads that have none.

A frame is on time when its clock is 1 to 250 ms after that of the last one taken (modulo 2^32, so the wrap
after 49.7 days is nothing special). One that repeats the last clock is a duplicate. Any other is held: it may
be damaged in a way the checksum does not see, or be the first after a reboot, a long gap or the start. A
later frame decides:

- the next frame is on time for the clock followed so far: what is held was damage, and is refused;
- a later frame is 1 to 250 ms after a held one: those two (and held ones that lead up to them in the same
  steps) are the sensor's new clock; they are delivered in order, and the rest of what is held is refused.

So no frame is taken on its own word when its clock jumps, and after a real reset the first frame is late by
one frame time and none is lost, even when damaged frames fall between. The single exception: a pad that
restarts within 250 ms of its last start cannot be told from one that did not.
"""

from touchd.drivers.frame import CLOCK_MODULUS
from touchd.drivers.pad.framing import ProtocolCounts, Reading

# Below 256 ms, the least by which a flipped bit that the checksum cannot see moves the clock.
MAX_STEP_MS = 250
MAX_HELD = 8


class ClockCheck:
    """Judges each well-formed frame by its clock; counts what it refuses in `counts`."""

    def __init__(self, counts: ProtocolCounts) -> None:
        self._counts = counts
        self._last_ms: int | None = None
        self._held: list[Reading] = []

    def reset(self) -> None:
        """Forget the clock: the port was reopened, and the sensor may have restarted."""
        self._last_ms = None
        self._refuse_held()

    def is_on_time(self, sensor_ms: int) -> bool:
        """Whether a frame of that time agrees with the clock followed so far."""
        return self._last_ms is not None and _steps_on(self._last_ms, sensor_ms)

    def judge(self, reading: Reading) -> list[Reading]:
        """Return what can be delivered now: nothing, this reading, or it after the held ones it confirms."""
        now_ms = reading.sensor_ms
        if self.is_on_time(now_ms):
            self._last_ms = now_ms
            self._refuse_held()
            return [reading]
        if now_ms == self._last_ms or any(now_ms == held.sensor_ms for held in self._held):
            self._counts.duplicates += 1
            return []
        run, others = [reading], []
        for held in reversed(self._held):
            if _steps_on(held.sensor_ms, run[0].sensor_ms):
                run.insert(0, held)
            else:
                others.append(held)
        if len(run) > 1:
            self._last_ms = now_ms
            self._held = others
            self._refuse_held()
            return run
        self._held.append(reading)
        if len(self._held) > MAX_HELD:
            del self._held[0]
            self._counts.bad_time += 1
        return []

    def _refuse_held(self) -> None:
        self._counts.bad_time += len(self._held)
        self._held.clear()


def _steps_on(earlier_ms: int, later_ms: int) -> bool:
    return 0 < (later_ms - earlier_ms) % CLOCK_MODULUS <= MAX_STEP_MS


# Shares of a frame's arrival error by which phase and period follow. A jitter of 16 ms
# (a USB adapter's) becomes 1.6 ms; a pad 5 % off its stated rate is followed within a second.
PHASE_GAIN = 0.1
PERIOD_GAIN = 0.005
LOST_S = 0.25
# Frames that flood in are stamped a millisecond apart; so far ahead of their arrival, the clock starts anew.
AHEAD_MS = 1000


class ArrivalClock:
    """Stamps frames of a pad without a clock by their arrival, jitter smoothed: a phase-locked fit.

    rate_hz: of the pad, as far as it is known. A frame more than LOST_S late resets it.
    """

    def __init__(self, rate_hz: float) -> None:
        self._stated_s = self._period_s = 1 / rate_hz
        self._expected_s: float | None = None
        self._last_ms = -1

    def reset(self) -> None:
        """Begin anew with the next frame."""
        self._period_s = self._stated_s
        self._expected_s = None

    def stamp_ms(self, host_s: float) -> int:
        """Return the stamp (uint32 ms) of a frame that arrived at `host_s`; they rise, but after a flood."""
        expected_s = self._expected_s
        off_s = 0.0 if expected_s is None else host_s - expected_s
        if expected_s is None or abs(off_s) > LOST_S:
            expected_s = host_s
        else:
            expected_s += PHASE_GAIN * off_s
            period_s = self._period_s + PERIOD_GAIN * off_s
            self._period_s = min(max(period_s, self._stated_s / 4), 4 * self._stated_s)
        self._expected_s = expected_s + self._period_s
        now_ms = round(1000 * expected_s)
        is_ahead = self._last_ms - now_ms > AHEAD_MS
        self._last_ms = now_ms if is_ahead else max(self._last_ms + 1, now_ms)
        return self._last_ms % CLOCK_MODULUS
