"""Uses the pad's clock to tell how old frames are."""

from touchd.drivers.pad.grid import GridFrame

# A frame that arrives later than the one before by more than this, by the pad's clock, was held up.
HELD_UP_S = 0.1
# Share by which a lasting delay is forgiven.
FORGIVEN_SHARE = 0.02


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
