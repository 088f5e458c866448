"""What the reader hands to the daemon's loop: frames and changes of state, in order, never without bound."""

from __future__ import annotations

import threading
from collections import deque

from drivers.frame import Frame
from drivers.pad.sensor_state import SensorState


class FrameQueue:
    """A bounded queue between two threads that gives up the oldest frame, never a state, when it is full.

    filled: notified when something is put; of several queues, one thread can wait on the same.
    dropped: frames given up so far. Only when nothing but `capacity` states waits unread does a state go.
    """

    def __init__(self, capacity: int = 540, filled: threading.Condition | None = None) -> None:
        self._capacity = capacity
        self._items: deque[Frame | SensorState] = deque()
        self._filled = filled or threading.Condition()
        self.dropped = 0

    def put(self, item: Frame | SensorState) -> None:
        """Add a frame or a state; never blocks."""
        with self._filled:
            if len(self._items) >= self._capacity:
                self._make_room()
            self._items.append(item)
            self._filled.notify()

    def get(self, timeout_s: float) -> Frame | SensorState | None:
        """Take the oldest item, waiting for one at most `timeout_s`; None when none came."""
        with self._filled:
            if not self._filled.wait_for(lambda: self._items, timeout_s):
                return None
            return self._items.popleft()

    def __len__(self) -> int:
        return len(self._items)

    def _make_room(self) -> None:
        for index, item in enumerate(self._items):
            if isinstance(item, Frame):
                del self._items[index]
                self.dropped += 1
                return
        self._items.popleft()
