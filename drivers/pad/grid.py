"""Resamples a pad's frames to the model's 54 Hz grid, by the sensor's own clock.

A pad whose frames keep step with the grid (54 Hz within about 1 %, whole-millisecond stamps and a little
jitter allowed for) passes unchanged, one sensor frame to one grid frame: interpolating it would only blur it.
Any other rate is interpolated linearly between the two neighbouring frames. A faster pad is not averaged: the
model learned on single scans and their noise.
"""

from collections import deque

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import CLOCK_MODULUS, COLUMNS, FRAME_RATE_HZ, ROWS, Frame
from touchd.drivers.pad.vibration import Vibration

PERIOD_MS = 1000.0 / FRAME_RATE_HZ
# A frame is in step if it is at most this far from its grid time. At 5 Hz, faster than a hand pats, such an
# offset changes values by 6 %; linear interpolation changes them by 4 %.
IN_STEP_MS = 2.0
# The grid's phase moves by this share of a frame's offset. It lags by 0.9 ms behind a pad that is 1 % off
# 54 Hz, which leaves 1.1 ms for jitter.
PHASE_GAIN = 0.2
# Frames pass unchanged after more than this many in step, and at the start.
IN_STEP_FRAMES = 27
# A step between two frames that is longer than usual by this factor has lost a frame.
LOST_STEP = 1.75
# The longest gap bridged by interpolation, which marks the touch as degraded. A longer gap ends the touch. At
# 0.15 s, 10 % of the third study's touches are split; at 0.2 s, 9 %.
MAX_GAP_MS = 200


class GridFrame(msgspec.Struct, frozen=True, eq=False):
    """One frame on the 54 Hz grid.

    index: rises by one from frame to frame and is never reused.
    sensor_ms: the sensor's clock at this point of the grid, unwrapped.
    host_s: arrival of the sensor frame that completed it, `time.monotonic()`.
    pressure: (8, 8) float32 counts, read-only.
    bridged: stands in for a lost frame. restarted: not contiguous with the frame before.
    """

    index: int
    sensor_ms: float
    host_s: float
    pressure: NDArray[np.float32]
    bridged: bool
    restarted: bool


class Ring:
    """The last `capacity` grid frames."""

    def __init__(self, capacity: int) -> None:
        self._history: deque[GridFrame] = deque(maxlen=capacity)
        self._next_index = 0
        self._sensor_ms: int | None = None
        self._clock_ms = 0
        self._pressure = np.zeros((ROWS, COLUMNS), np.float32)
        self._grid_ms = 0.0
        self._phase_ms = 0.0
        self._in_step = IN_STEP_FRAMES
        self._vibration = Vibration()

    def push(self, frame: Frame) -> list[GridFrame]:
        """Take the sensor's next frame; return the grid frames that it completes, oldest first.

        Return none for a duplicate; one, marked `restarted`, for the first frame, after a gap too long to
        bridge, and if the sensor's clock runs back.
        """
        pressure = frame.pressure.astype(np.float32)
        if self._sensor_ms is None:
            return [self._restart(frame, pressure)]
        elapsed_ms = (frame.sensor_ms - self._sensor_ms) % CLOCK_MODULUS
        if elapsed_ms == 0:
            return []
        if elapsed_ms > MAX_GAP_MS:
            return [self._restart(frame, pressure)]
        now_ms = self._clock_ms + elapsed_ms
        self._follow_phase(now_ms)
        is_in_step = self._in_step > IN_STEP_FRAMES
        count = int((now_ms - self._grid_ms) / PERIOD_MS - (0.5 if is_in_step else 0.0))
        due_ms = [self._grid_ms + (i + 1) * PERIOD_MS for i in range(count)]
        if is_in_step:
            due_ms.append(float(now_ms))
        frames = [self._between(frame, pressure, now_ms, at_ms) for at_ms in due_ms]
        self._sensor_ms, self._clock_ms, self._pressure = frame.sensor_ms, now_ms, pressure
        return frames

    def reset(self) -> None:
        """Treat the next frame as the first of another sensor; the history and its indices stay."""
        self._sensor_ms = None

    def frames(self, start_index: int, stop_index: int) -> list[GridFrame]:
        """Return the frames start_index <= index < stop_index; raises ValueError unless all are there.

        They are contiguous unless a frame after the first is marked `restarted`.
        """
        oldest = self._next_index - len(self._history)
        if not oldest <= start_index < stop_index <= self._next_index:
            raise ValueError(
                f"no frames {start_index} to {stop_index} in the ring, it has {oldest} to {self._next_index}"
            )
        # Index from the newest end: an answer takes few frames, and a deque is fast only near its ends.
        return [self._history[index - self._next_index] for index in range(start_index, stop_index)]

    def window(self, stop_index: int, length: int) -> NDArray[np.float32]:
        """Return the `length` frames before stop_index as (length, 8, 8) float32 counts; see `frames`."""
        frames = self.frames(stop_index - length, stop_index)
        return np.concatenate([frame.pressure for frame in frames]).reshape(length, ROWS, COLUMNS)

    def _restart(self, frame: Frame, pressure: NDArray[np.float32]) -> GridFrame:
        self._sensor_ms, self._clock_ms, self._pressure = frame.sensor_ms, frame.sensor_ms, pressure
        self._phase_ms = float(frame.sensor_ms)
        return self._lay(frame.sensor_ms, frame.host_s, pressure, restarted=True)

    def _follow_phase(self, now_ms: int) -> None:
        """Count the frames in step with a 54 Hz grid, and move its phase towards them."""
        periods = max(1, round((now_ms - self._phase_ms) / PERIOD_MS))
        off_ms = now_ms - (self._phase_ms + periods * PERIOD_MS)
        if abs(off_ms) <= IN_STEP_MS:
            self._phase_ms = now_ms - (1.0 - PHASE_GAIN) * off_ms
            self._in_step += 1
        else:
            self._phase_ms = float(now_ms)
            self._in_step = 0

    def _between(self, frame: Frame, pressure: NDArray[np.float32], now_ms: int, at_ms: float) -> GridFrame:
        """Lay the grid frame at `at_ms`, between the previous sensor frame and this one."""
        if at_ms == now_ms:
            return self._lay(at_ms, frame.host_s, pressure)
        span_ms = now_ms - self._clock_ms
        share = np.float32((at_ms - self._clock_ms) / span_ms)
        laid = self._pressure + share * (pressure - self._pressure)
        return self._lay(at_ms, frame.host_s, laid, bridged=span_ms > LOST_STEP * PERIOD_MS)

    def _lay(
        self,
        at_ms: float,
        host_s: float,
        pressure: NDArray[np.float32],
        bridged: bool = False,
        restarted: bool = False,
    ) -> GridFrame:
        if restarted:
            self._vibration = Vibration()
        pressure = self._vibration.take_out(pressure)
        pressure.flags.writeable = False
        laid = GridFrame(self._next_index, float(at_ms), host_s, pressure, bridged, restarted)
        self._history.append(laid)
        self._next_index += 1
        self._grid_ms = float(at_ms)
        return laid
