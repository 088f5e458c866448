"""Collects the frames of each touch and has them written to disk, where configured.

In the loop a frame costs two appends. A thread of its own cuts, packs and writes, only after a touch, when
the next answer is a second away or more.
"""

from collections import defaultdict, deque
from collections.abc import Mapping

from touchd.daemon.events import Event, SensorEvent, TouchBegan, TouchEnded
from touchd.daemon.kept.touch_frames import FeltTouch
from touchd.daemon.kept.touch_store import TouchStore
from touchd.daemon.sinks import QueuedSink
from touchd.drivers.frame import CLOCK_MODULUS, DEFAULT_PAD, FRAME_RATE_HZ, Frame

# A second of rest, and as long as a touch may have gone on before it is noticed; of a pad of 500 Hz.
RECENT_MS, RECENT_FRAMES = 3000, 1500
LONGEST_FRAMES = round(60.0 * FRAME_RATE_HZ)


class TouchSink(QueuedSink[FeltTouch]):
    """A sink that keeps the frames of touches, for the pads that have a store; for others it does nothing.

    Frames and the events that they cause come from one thread, a frame before its events.
    """

    capacity = 8

    def __init__(self, stores: Mapping[str, TouchStore]) -> None:
        super().__init__("touches")
        self._stores = stores
        self._pads: defaultdict[str, _PadFrames] = defaultdict(_PadFrames)

    def take(self, frame: Frame, pad: str = DEFAULT_PAD) -> None:
        if pad in self._stores:
            self._pads[pad].take(frame)

    def put(self, item: Event | FeltTouch) -> None:
        """Take note that a touch began, or have one that ended written; returns at once."""
        match item:
            case TouchBegan() if item.pad in self._pads:
                self._pads[item.pad].begin(item)
            case TouchEnded(sensor_ms=int(end_ms)) if item.pad in self._pads:
                touch = self._pads[item.pad].end(item, end_ms)
                if touch is not None:
                    super().put(touch)
            case SensorEvent(state="down"):
                # The next frames are another pad's, or its clock restarted.
                self._pads.pop(item.pad, None)

    def write(self, item: FeltTouch) -> None:
        self._stores[item.began.pad].add(item)


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
        while (frame.sensor_ms - self._recent[0].sensor_ms) % CLOCK_MODULUS > RECENT_MS:
            self._recent.popleft()
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
