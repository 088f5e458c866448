"""The base class of parsers: counts, clock and layout."""

from abc import ABC, abstractmethod

import numpy as np

from touchd.drivers.frame import Frame
from touchd.drivers.pad.clock import FrameClock
from touchd.drivers.pad.format import PadFormat, Values, layout_of
from touchd.drivers.pad.protocol_counts import ProtocolCounts

# What an ESP32 or ESP8266 prints when it crashes and starts.
BOOT_LOG = (b"Guru Meditation", b"rst:0x", b"rst cause", b"Brownout detector", b"ESP-ROM:")
LONGEST_MARK = max(map(len, BOOT_LOG))


class FrameParser(ABC):
    """A parser: drops and counts damaged frames, never raises on them, keeps a bounded number of bytes."""

    def __init__(self, described: PadFormat) -> None:
        self.counts = ProtocolCounts()
        self.format = described
        self._layout = layout_of(described)
        self.clock = FrameClock(self.counts, described.rate_hz)
        self._buffer = b""
        self._tail = b""

    def feed(self, data: bytes, host_s: float) -> list[Frame]:
        """Take bytes that arrived at `host_s` (monotonic seconds); return the frames they completed."""
        latest = self._tail + data
        self._tail = latest[1 - LONGEST_MARK :]
        for mark in BOOT_LOG:
            if mark in latest:
                self.counts.restarted()
        frames = self._parse(data, host_s)
        self.counts.frames += len(frames)
        return frames

    @abstractmethod
    def _parse(self, data: bytes, host_s: float) -> list[Frame]:
        """Take the next bytes; return the accepted frames that they completed."""

    def reset(self) -> None:
        """Forget half a frame and the clock after a reconnect; counts go on."""
        self.counts.bytes_dropped += len(self._buffer)
        self._buffer = self._tail = b""
        self.clock.reset()

    def _judge(self, stamp: float | None, host_s: float, values: Values, highest: float) -> list[Frame]:
        """Return the frames that a well-formed one confirms, itself included.

        stamp: its clock as sent, None for a pad without one. values: (cells,) as sent; those out of range are
        cut. highest: of the values.
        """
        if highest > self.format.full_scale:
            self.counts.clipped += 1
            values = np.minimum(values, self.format.full_scale)
        if values.dtype.kind != "u":
            values = np.maximum(values, 0)
        pressure = self._layout.pressure(values)
        return self.clock.judge(stamp, host_s, pressure)
