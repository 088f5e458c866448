"""From a pad's bytes to its frames: framing, clock and layout, as described; no I/O."""

import numpy as np

from touchd.drivers.frame import Frame, ProtocolCounts
from touchd.drivers.pad.binary import BinaryFraming
from touchd.drivers.pad.clock import PadClock
from touchd.drivers.pad.format import Layout, PadFormat, RawFrame
from touchd.drivers.pad.text import TextFraming


class FrameParser:
    """Parses what a pad sends: drops and counts damaged frames, never raises on them, keeps few bytes."""

    def __init__(self, described: PadFormat) -> None:
        self.counts = ProtocolCounts()
        self.format = described
        framing = TextFraming if described.framing == "text" else BinaryFraming
        self._framing: TextFraming | BinaryFraming = framing(described, self.counts)
        self._layout = Layout(described)
        self._clock = PadClock(self.counts, described.clock)

    @property
    def dates_frames(self) -> bool:
        """Whether the pad's clock dates the frames, so that it does not matter when they are read."""
        return self._clock.dates_frames

    def feed(self, data: bytes, host_s: float) -> list[Frame]:
        """Take bytes that arrived at `host_s` (monotonic seconds); return the frames they completed."""
        frames = [frame for raw in self._framing.feed(data, host_s) for frame in self._frames(raw)]
        self.counts.frames += len(frames)
        return frames

    def reset(self) -> None:
        """Forget half a frame and the clock after a reconnect; counts go on."""
        self._framing.reset()
        self._clock.reset()

    def _frames(self, raw: RawFrame) -> list[Frame]:
        """Return the frames that a well-formed one confirms, itself included; cut values out of range."""
        values = raw.values
        if raw.highest > self.format.full_scale:
            self.counts.clipped += 1
            values = np.minimum(values, self.format.full_scale)
        if values.dtype.kind != "u":
            values = np.maximum(values, 0)
        return self._clock.date(raw.stamp, raw.host_s, self._layout.pressure(values))
