"""Gathers the pad's frames of each touch as it goes by, and has them written to disk where that is wanted.

In the loop a frame costs two appends; cutting, packing and writing are done in a thread of their own. It has
work only after a touch, when the next answer is a second away or more.
"""

from __future__ import annotations

import threading
from collections import deque

from daemon.events import Event, SensorEvent, TouchBegan, TouchEnded
from daemon.kept.touch_frames import FeltTouch
from daemon.kept.touch_store import TouchStore
from daemon.sinks import QueuedSink
from drivers.frame import FRAME_RATE_HZ, Frame

# A second of rest, and as long as a touch may have gone on before it is noticed, of a pad of 100 Hz.
RECENT_FRAMES = 160
LONGEST_FRAMES = round(60.0 * FRAME_RATE_HZ)
CAPACITY = 8


class TouchSink:
    """A sink that keeps the frames of touches, if there is a store for them; without one it does nothing.

    Frames and the events that they cause come from one thread, a frame before its events.
    """

    name = "touches"

    def __init__(self, store: TouchStore | None) -> None:
        self._writer = _Writer(store)
        self._recent: deque[Frame] = deque(maxlen=RECENT_FRAMES)
        self._began: TouchBegan | None = None
        self._noticed = 0
        self._frames: list[Frame] = []
        self._quiet_from_ms: int | None = None

    def take(self, frame: Frame) -> None:
        """Take the pad's next frame."""
        if self._writer.store is None:
            if self._recent:
                self._forget()
            return
        self._recent.append(frame)
        if self._began is not None and len(self._frames) < LONGEST_FRAMES:
            self._frames.append(frame)

    def put(self, event: Event) -> None:
        """Take note that a touch began, or have one that ended written; returns at once."""
        match event:
            case TouchBegan() if self._recent:
                self._began, self._frames = event, list(self._recent)
                self._noticed = len(self._frames)
            case TouchEnded(sensor_ms=int(end_ms)):
                if self._began is not None:
                    touch = FeltTouch(
                        self._began, event, tuple(self._frames), self._noticed, end_ms, self._quiet_from_ms
                    )
                    self._writer.put(touch)
                self._began, self._frames, self._quiet_from_ms = None, [], end_ms
            case SensorEvent():
                # What comes is another pad's, or of one whose clock has started anew.
                self._forget()

    def use(self, store: TouchStore | None) -> None:
        """Write to another store from the next touch on; from any thread."""
        self._writer.use(store)

    def _forget(self) -> None:
        self._recent.clear()
        self._began, self._frames, self._quiet_from_ms = None, [], None

    @property
    def dropped(self) -> int:
        """Touches that the disk was too slow for."""
        return self._writer.dropped

    def stop(self, timeout_s: float) -> None:
        """Write what is queued, as far as the time allows."""
        self._writer.stop(timeout_s)


class _Writer(QueuedSink[FeltTouch]):
    """The queue of touches, and the thread that writes them."""

    def __init__(self, store: TouchStore | None) -> None:
        self.store = store
        self._using = threading.Lock()
        super().__init__("touches", CAPACITY)

    def use(self, store: TouchStore | None) -> None:
        """Write to another store from the next touch on."""
        with self._using:
            self.store = store

    def write(self, item: FeltTouch) -> None:
        """Write one touch."""
        with self._using:
            if self.store is not None:
                self.store.add(item)
