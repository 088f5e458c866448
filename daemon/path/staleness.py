"""How old frames are, by the pad's clock; an answer about frames that are too old is not told."""

import math

from touchd.drivers.pad.grid import GridFrame

# If a frame's lag grows by more than this, it was held up on its way; smaller growth is clock drift.
HELD_UP_S = 0.1
# The offset follows a lasting lag by 2 % of the elapsed time, so it reaches it in fifty times the lag.
FORGIVEN_SHARE = 0.02


class Staleness:
    """Tracks the offset between the pad's clock and the host's; a frame's age is its lag beyond it.

    It follows a clock that drifts without jumps, as of a pad that is played slowly or runs slightly off.
    """

    def __init__(self) -> None:
        self._last: GridFrame | None = None
        self._offset_s = math.inf

    def update(self, frame: GridFrame) -> None:
        lag_s, last = _lag_s(frame), self._last
        self._last = frame
        # A clock that runs back has restarted, with a new offset: even frames that are held up come in order.
        if last is None or frame.sensor_ms < last.sensor_ms:
            self._offset_s = lag_s
            return
        later_s = lag_s - _lag_s(last)
        if later_s <= HELD_UP_S:
            self._offset_s += max(0.0, later_s)
        passed_s = min(frame.host_s - last.host_s, HELD_UP_S)
        self._offset_s = min(lag_s, self._offset_s + FORGIVEN_SHARE * passed_s)

    def forget(self) -> None:
        """Forget the offset: the next frames are of another pad, or the pad's clock restarted."""
        self._last, self._offset_s = None, math.inf

    def age_s(self, frame: GridFrame, now_s: float) -> float:
        """Return a frame's age at a time of the host's clock; 0 while the offset is unknown."""
        return max(0.0, now_s - frame.sensor_ms / 1000.0 - self._offset_s)


def _lag_s(frame: GridFrame) -> float:
    return frame.host_s - frame.sensor_ms / 1000.0
