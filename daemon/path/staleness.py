"""How old frames are, by the pad's clock; an answer about frames that are too old is not told."""

from touchd.drivers.pad.grid import GridFrame

# A frame whose lag grows by more than this was held up on its way; a smaller growth is drift of the pad's
# clock.
HELD_UP_S = 0.1
# A lasting lag is forgiven at 2 % of the time that passes, so within fifty times its length.
FORGIVEN_SHARE = 0.02


class Staleness:
    """Tracks the offset between the pad's clock and the host's; a frame's age is its lag beyond it.

    A clock that drifts without a jump, as of a pad that is played slowly or runs slightly off, is followed.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._lag_s = 0.0
        self._host_s = 0.0
        self._sensor_ms = 0.0

    def update(self, frame: GridFrame) -> None:
        if frame.sensor_ms < self._sensor_ms:
            # The pad's clock restarted; frames that are held up would still arrive in order.
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
        """Forget the offset: the next frames are another pad's, or the pad's clock restarted."""
        self._offset_s = None

    def age_s(self, frame: GridFrame, now_s: float) -> float:
        """Return a frame's age at a time of the host's clock."""
        if self._offset_s is None:
            return 0.0
        return max(0.0, now_s - self._offset_s - frame.sensor_ms / 1000.0)
