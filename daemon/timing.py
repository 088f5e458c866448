"""Uses the pad's clock to tell how old frames are, and whether touches can be felt."""

from collections import deque
from itertools import pairwise

from touchd.daemon.tracker.tracker import CALIBRATION_FRAMES
from touchd.drivers.frame import CLOCK_MODULUS, FRAME_RATE_HZ, Frame
from touchd.drivers.pad.grid import MAX_GAP_S, GridFrame

# A frame that arrives later than the one before by more than this, by the pad's clock, was held up.
HELD_UP_S = 0.1
# Share by which a lasting delay is forgiven.
FORGIVEN_SHARE = 0.02
# Feeling a touch takes half a second of frames without a gap; report when there was none for this long.
DEAF_S = 3.0


class Age:
    """Age of frames: their delay beyond the current offset between the pad's clock and the host's.

    A pad that plays slowly, or whose clock is slightly off, drifts without a jump and is followed.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._lag_s = 0.0
        self._host_s = 0.0
        self._sensor_ms = 0.0

    def update(self, frame: GridFrame) -> None:
        if frame.sensor_ms < self._sensor_ms:
            # The pad's clock started anew. Frames that were held up come late, but in order.
            self.forget()
        self._sensor_ms = frame.sensor_ms
        lag_s = frame.host_s - frame.sensor_ms / 1000.0
        later_s, passed_s = lag_s - self._lag_s, max(0.0, frame.host_s - self._host_s)
        self._lag_s, self._host_s = lag_s, frame.host_s
        if self._offset_s is None or lag_s < self._offset_s:
            self._offset_s = lag_s
            return
        if 0.0 < later_s <= HELD_UP_S:
            self._offset_s += later_s
        self._offset_s = min(lag_s, self._offset_s + FORGIVEN_SHARE * min(passed_s, HELD_UP_S))

    def forget(self) -> None:
        """The next frames are another pad's, or its clock restarted."""
        self._offset_s = None

    def of(self, frame: GridFrame, now_s: float) -> float:
        """Return a frame's age in seconds at a time of the host's."""
        if self._offset_s is None:
            return 0.0
        return max(0.0, now_s - self._offset_s - frame.sensor_ms / 1000.0)


class Feeling:
    """Whether frames come close enough together, by the pad's clock, for touches to be felt."""

    def __init__(self) -> None:
        self._frames: deque[Frame] = deque(maxlen=CALIBRATION_FRAMES)
        self._without_gap = 0
        self._since_s: float | None = None
        self._is_degraded = False

    def update(self, frame: Frame, restarted: bool) -> str | None:
        """Take a frame, and whether the grid restarted with it; return what changed, None for nothing.

        What changed is the reason why touches can no longer be felt, or "" when they can again.
        """
        self._frames.append(frame)
        self._without_gap = 0 if restarted else self._without_gap + 1
        if self._since_s is None:
            self._since_s = frame.host_s
        if self._without_gap >= CALIBRATION_FRAMES:
            self._since_s = frame.host_s
            if self._is_degraded:
                self._is_degraded = False
                return ""
        elif not self._is_degraded and frame.host_s - self._since_s >= DEAF_S and restarted:
            self._is_degraded = True
            return self._why()
        return None

    def forget(self) -> None:
        """The pad went away."""
        self.__init__()  # type: ignore[misc]

    def _why(self) -> str:
        first, last = self._frames[0], self._frames[-1]
        steps = len(self._frames) - 1
        step_ms = ((last.sensor_ms - first.sensor_ms) % CLOCK_MODULUS) / steps
        # Frames that were read together all arrived at once.
        rate_hz = steps / max(last.host_s - first.host_s, 0.001)
        steps_ms = [(b.sensor_ms - a.sensor_ms) % CLOCK_MODULUS for a, b in pairwise(self._frames)]
        if max(steps_ms) > CLOCK_MODULUS // 2:
            return (
                "no touch can be felt: the pad's clock goes back and forth; do frames overtake one another "
                "on the way, or do two boards send there?"
            )
        if rate_hz > 1.0 / MAX_GAP_S:
            # By how many milliseconds the clock advances in a second.
            if not 500 < step_ms * rate_hz < 2000:
                return (
                    f"no touch can be felt: {rate_hz:.0f} frames a second come, but the pad's clock has them "
                    f"{step_ms:.0f} ms apart; it must count milliseconds"
                )
            return (
                f"no touch can be felt: {rate_hz:.0f} frames a second come, with gaps of up to "
                f"{max(steps_ms)} ms; are frames lost on the way?"
            )
        return (
            f"no touch can be felt: {rate_hz:.1f} frames a second come, and more than "
            f"{1.0 / MAX_GAP_S:.0f} are needed, best {FRAME_RATE_HZ:.0f}"
        )
