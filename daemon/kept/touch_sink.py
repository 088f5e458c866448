"""Gathers the pad's frames of each touch as it goes by, and has them written to disk where that is wanted.

In the loop a frame costs two appends; cutting, packing and writing are done in a thread of their own. It has
work only after a touch, when the next answer is a second away or more.
"""

from __future__ import annotations

import threading
from collections import defaultdict, deque
from collections.abc import Mapping

from daemon.events import Event, SensorEvent, TouchBegan, TouchEnded
from daemon.kept.touch_frames import FeltTouch
from daemon.kept.touch_store import TouchStore
from daemon.sinks import QueuedSink
from drivers.frame import DEFAULT_PAD, FRAME_RATE_HZ, Frame

# A second of rest, and as long as a touch may have gone on before it is noticed, of a pad of 100 Hz.
RECENT_FRAMES = 160
LONGEST_FRAMES = round(60.0 * FRAME_RATE_HZ)
CAPACITY = 8


class TouchSink:
    """A sink that keeps the frames of touches, for the pads that have a store; for others it does nothing.

    Frames and the events that they cause come from one thread, a frame before its events.
    """

    name = "touches"

    def __init__(self, stores: Mapping[str, TouchStore]) -> None:
        self._writer = _Writer(stores)
        self._pads: defaultdict[str, _PadFrames] = defaultdict(_PadFrames)

    def take(self, frame: Frame, pad: str = DEFAULT_PAD) -> None:
        """Take a pad's next frame."""
        if pad in self._writer.stores:
            self._pads[pad].take(frame)
        elif self._pads:
            self._pads.pop(pad, None)

    def put(self, event: Event) -> None:
        """Take note that a touch began, or have one that ended written; returns at once."""
        match event:
            case TouchBegan() if event.pad in self._pads:
                self._pads[event.pad].begin(event)
            case TouchEnded(sensor_ms=int(end_ms)) if event.pad in self._pads:
                touch = self._pads[event.pad].end(event, end_ms)
                if touch is not None:
                    self._writer.put(touch)
            case SensorEvent():
                # What comes is another pad's, or of one whose clock has started anew.
                self._pads.pop(event.pad, None)

    def use(self, stores: Mapping[str, TouchStore]) -> None:
        """Write to other stores from the next touch on; from any thread."""
        self._writer.use(stores)

    @property
    def dropped(self) -> int:
        """Touches that the disk was too slow for."""
        return self._writer.dropped

    def stop(self, timeout_s: float) -> None:
        """Write what is queued, as far as the time allows."""
        self._writer.stop(timeout_s)


class _PadFrames:
    """The last frames of one pad, and those of the touch that goes on."""

    def __init__(self) -> None:
        self._recent: deque[Frame] = deque(maxlen=RECENT_FRAMES)
        self._began: TouchBegan | None = None
        self._noticed = 0
        self._frames: list[Frame] = []
        self._quiet_from_ms: int | None = None

    def take(self, frame: Frame) -> None:
        self._recent.append(frame)
        if self._began is not None and len(self._frames) < LONGEST_FRAMES:
            self._frames.append(frame)

    def begin(self, event: TouchBegan) -> None:
        self._began, self._frames = event, list(self._recent)
        self._noticed = len(self._frames)

    def end(self, event: TouchEnded, end_ms: int) -> FeltTouch | None:
        began, frames, quiet_from_ms = self._began, tuple(self._frames), self._quiet_from_ms
        self._began, self._frames, self._quiet_from_ms = None, [], end_ms
        if began is None:
            return None
        return FeltTouch(began, event, frames, self._noticed, end_ms, quiet_from_ms)


class _Writer(QueuedSink[FeltTouch]):
    """The queue of touches, and the thread that writes them."""

    def __init__(self, stores: Mapping[str, TouchStore]) -> None:
        self.stores = stores
        self._using = threading.Lock()
        super().__init__("touches", CAPACITY)

    def use(self, stores: Mapping[str, TouchStore]) -> None:
        """Write to other stores from the next touch on."""
        with self._using:
            self.stores = stores

    def write(self, item: FeltTouch) -> None:
        """Write one touch."""
        with self._using:
            if store := self.stores.get(item.began.pad):
                store.add(item)
