"""The fabric pad's binary format: bytes in, frames out, no I/O.

Format (the lab's public firmware, little-endian, free-running): header FF FF FF FF, uint32 milliseconds since
boot, rows x columns uint16 raw values row by row, one checksum byte (low byte of the sum of all values and
the time).

Which frames are intact: read from the left, a window of one frame's length is well-formed when it begins with
the header, holds no value above 1023 and its checksum is right; the sensor's clock then decides (see
`clock.py`). A window refused for any of these is given up by its first byte only, so a true frame that
begins inside is found. The checksum sums low bytes only: a flip in bit 8 or 9 of a value is invisible to this
format, and no reader can tell. A flip in the upper bytes of the time is invisible to it too, and is caught by
the clock.
"""

from __future__ import annotations

import struct
from typing import Literal

import numpy as np

from drivers.frame import MAX_COUNT, Counts, Frame
from drivers.pad.clock import ClockCheck
from drivers.pad.framing import CLOCK_MODULUS, Geometry, ProtocolCounts, Reading, number_frames

HEADER = b"\xff\xff\xff\xff"
TIME = struct.Struct("<I")
TIME_AT = len(HEADER)
VALUES_AT = TIME_AT + TIME.size
MAX_HIGH_BYTE = MAX_COUNT >> 8

Damage = Literal["bad_value", "bad_checksum", "bad_time"]


def frame_bytes(taxels: int) -> int:
    """Return the length on the wire of a frame of that many values."""
    return VALUES_AT + 2 * taxels + 1


def damage_in(window: bytes) -> Damage | None:
    """Say what is wrong with a whole window that begins with the header; None when it is well-formed."""
    # Looking at the first value alone is enough, and quick, in a long run of FF.
    if window[VALUES_AT + 1] > MAX_HIGH_BYTE or max(window[VALUES_AT + 1 : -1 : 2]) > MAX_HIGH_BYTE:
        return "bad_value"
    # The low byte of a sum is that of the sum of low bytes.
    if (sum(window[VALUES_AT:-1:2]) + window[TIME_AT]) & 0xFF != window[-1]:
        return "bad_checksum"
    return None


def encode_fabric_grid(
    counts: Counts, sensor_ms: int, rows: int = 10, columns: int = 10, crop: int = 1, invert: bool = True
) -> bytes:
    """Return pressure (8, 8) at `sensor_ms` as the pad would send it; border taxels feel nothing."""
    raw = Geometry(rows, columns, crop, invert).raw(counts)
    time = sensor_ms % CLOCK_MODULUS
    checksum = (int(raw.sum()) + time) & 0xFF
    return HEADER + TIME.pack(time) + raw.astype("<u2").tobytes() + bytes([checksum])


class FabricGrid:
    """Parser for the fabric pad's binary format.

    Keeps less than two frames' bytes between calls whatever comes in. Raises ProtocolError when rows, columns
    and crop do not leave 8x8 taxels; `feed` never raises.
    """

    def __init__(self, rows: int = 10, columns: int = 10, crop: int = 1, invert: bool = True) -> None:
        self._geometry = Geometry(rows, columns, crop, invert)
        self._size = frame_bytes(self._geometry.taxels)
        self.counts = ProtocolCounts()
        self._clock = ClockCheck(self.counts)
        self._buffer = b""
        self._position = 0
        # Bytes still to be dropped that belong to a damaged frame already counted.
        self._claimed = 0
        # The window that began one byte before the position was refused: both lie in one run of FF.
        self._in_refused_run = False

    @property
    def description(self) -> str:
        """What this parser expects, in words for a person."""
        return f"fabric-grid {self._geometry}"

    @property
    def pending_bytes(self) -> int:
        """Bytes kept until more arrive."""
        return len(self._buffer)

    def feed(self, data: bytes, host_s: float) -> list[Frame]:
        """Take bytes that arrived at `host_s` (monotonic seconds); return the frames they completed."""
        self._buffer += data
        readings: list[Reading] = []
        while self._seek_header() and (taken := self._take(host_s)) is not None:
            readings += taken
        self._buffer = self._buffer[self._position :]
        self._position = 0
        return number_frames(readings, self.counts)

    def reset(self) -> None:
        """Forget half a frame and the clock after a reconnect; counts and frame numbers go on."""
        self.counts.bytes_dropped += len(self._buffer)
        self._buffer = b""
        self._claimed = 0
        self._in_refused_run = False
        self._clock.reset()

    def _seek_header(self) -> bool:
        """Move to the next header, dropping what comes before; False when none is in the buffer."""
        start = self._buffer.find(HEADER, self._position)
        if start >= 0:
            self._drop(start - self._position)
            return True
        # The last bytes may be the beginning of a header whose rest is still to come.
        tail = self._buffer[self._position :][-len(HEADER) + 1 :]
        self._drop(len(self._buffer) - self._position - (len(tail) - len(tail.rstrip(HEADER))))
        return False

    def _take(self, host_s: float) -> list[Reading] | None:
        """Judge the window at the position: the readings it lets out, or None when it takes more bytes."""
        window = self._buffer[self._position : self._position + self._size]
        if len(window) < self._size:
            return None
        if damage := damage_in(window):
            self._refuse(damage)
            return []
        (sensor_ms,) = TIME.unpack_from(window, TIME_AT)
        if not self._clock.is_on_time(sensor_ms):
            hides_another = self._hides_another()
            if hides_another is None:
                return None
            if hides_another:
                self._refuse("bad_time")
                return []
        self._position += self._size
        self._claimed = 0
        self._in_refused_run = False
        raw = np.frombuffer(window, "<u2", self._geometry.taxels, VALUES_AT)
        return self._clock.judge(Reading(sensor_ms, host_s, self._geometry.pressure(raw)))

    def _hides_another(self) -> bool | None:
        """Whether a well-formed window begins inside the one at the position, None when it takes more bytes.

        Then the outer one, whose clock jumps, is false: in two true frames running, the header of the second
        would be a value above 1023 in every window that begins inside the first.
        """
        inner = self._position
        while (inner := self._buffer.find(HEADER, inner + 1, self._position + self._size)) >= 0:
            window = self._buffer[inner : inner + self._size]
            if len(window) < self._size:
                return None
            if damage_in(window) is None:
                return True
        return False

    def _refuse(self, damage: Damage) -> None:
        """Give up the window at the position by its first byte; one run of FF is counted once."""
        if not self._in_refused_run:
            self.counts.bad_value += damage == "bad_value"
            self.counts.bad_checksum += damage == "bad_checksum"
            self.counts.bad_time += damage == "bad_time"
            self._claimed = self._size
        self._drop(1)
        self._in_refused_run = True

    def _drop(self, count: int) -> None:
        """Pass over bytes of no frame; each frame's length that no refusal explains counts as one lost."""
        if count == 0:
            return
        self._position += count
        self._in_refused_run = False
        self.counts.bytes_dropped += count
        unexplained = count - self._claimed
        lost = max(0, -(-unexplained // self._size))
        self.counts.bad_framing += lost
        self._claimed = lost * self._size - unexplained
