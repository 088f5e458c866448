"""The fabric pad's binary format: bytes in, frames out, no I/O.

Format (the lab's public firmware, little-endian, free-running): header FF FF FF FF, uint32 milliseconds since
boot, rows x columns uint16 raw values row by row, one checksum byte (low byte of the sum of all values and
the time).

Which frames are intact: read from the left, a window of one frame's length is well-formed when it begins with
the header, holds no value above 1023 and its checksum is right; the sensor's clock then decides (see
`drivers.clock`). A window refused for any of these is given up by its first byte only, so a true frame that
begins inside is found. The checksum sums low bytes only: a flip in bit 8 or 9 of a value is invisible to this
format, and no reader can tell. A flip in the upper bytes of the time is invisible to it too, and is caught by
the clock.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from drivers.clock import ClockCheck
from drivers.frame import MAX_COUNT, Counts, Frame
from drivers.framing import CLOCK_MODULUS, Geometry, ProtocolCounts, Reading, number_frames

HEADER = b"\xff\xff\xff\xff"
# Cheap to look at, and wrong in every false header within a long run of FF.
HIGH_BYTE_OF_FIRST_VALUE = 9
# Enough windows at once for numpy to pay off; checking more would be wasted where a frame is damaged.
BATCH = 64


def record_type(rows: int, columns: int) -> np.dtype[np.void]:
    """Return one frame on the wire as a packed numpy record: 4 + 4 + 2 * rows * columns + 1 bytes."""
    return np.dtype([("header", "<u4"), ("time", "<u4"), ("raw", "<u2", (rows, columns)), ("checksum", "u1")])


def well_formed(records: NDArray[np.void]) -> NDArray[np.bool_]:
    """Return which of the records (T,) have the header, values a pad can send and the right checksum."""
    raw = records["raw"]
    checksum = (raw.sum(axis=(1, 2), dtype=np.uint32) + records["time"]) & 0xFF
    in_range = raw.max(axis=(1, 2)) <= MAX_COUNT
    intact: NDArray[np.bool_] = (
        (records["header"] == 0xFFFFFFFF) & in_range & (checksum == records["checksum"])
    )
    return intact


def encode_fabric_grid(
    counts: Counts, sensor_ms: int, rows: int = 10, columns: int = 10, crop: int = 1, invert: bool = True
) -> bytes:
    """Return pressure (8, 8) at `sensor_ms` as the pad would send it; border taxels feel nothing."""
    raw = Geometry(rows, columns, crop, invert).raw(counts)
    time = sensor_ms % CLOCK_MODULUS
    checksum = (int(raw.sum()) + time) & 0xFF
    return HEADER + struct.pack("<I", time) + raw.astype("<u2").tobytes() + bytes([checksum])


class FabricGrid:
    """Parser for the fabric pad's binary format.

    Keeps less than two frames' bytes between calls whatever comes in. Raises ProtocolError when rows, columns
    and crop do not leave 8x8 taxels; `feed` never raises.
    """

    def __init__(self, rows: int = 10, columns: int = 10, crop: int = 1, invert: bool = True) -> None:
        self._geometry = Geometry(rows, columns, crop, invert)
        self._record = record_type(rows, columns)
        self._size = self._record.itemsize
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
        self._buffer = self._buffer[self._position :] + data
        self._position = 0
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
        if start < 0:
            # The last bytes may be the beginning of a header whose rest is still to come.
            tail = self._buffer[self._position :][-len(HEADER) + 1 :]
            self._drop(len(self._buffer) - self._position - (len(tail) - len(tail.rstrip(HEADER))))
            return False
        self._drop(start - self._position)
        return True

    def _take(self, host_s: float) -> list[Reading] | None:
        """Judge what begins at the header at the position; None when it takes more bytes to tell."""
        windows = (len(self._buffer) - self._position) // self._size
        if windows == 0:
            return None
        if self._buffer[self._position + HIGH_BYTE_OF_FIRST_VALUE] > MAX_COUNT >> 8:
            self._refuse(value_too_high=True)
            return []
        windows = min(windows, 1 if self._claimed else BATCH)
        records = np.frombuffer(self._buffer, self._record, windows, self._position)
        intact = well_formed(records)
        run = windows if intact.all() else int(intact.argmin())
        if run == 0:
            self._refuse(value_too_high=bool(records["raw"][0].max() > MAX_COUNT))
            return []
        on_time = self._clock.take_run(records["time"][:run])
        if on_time:
            return self._accept(records[:on_time], host_s)
        return self._take_jump(records[:1], host_s)

    def _take_jump(self, record: NDArray[np.void], host_s: float) -> list[Reading] | None:
        """Judge a well-formed window whose clock jumps; a well-formed one inside it shows that it is false.

        Two frames in a row cannot hold one: the second's header would be a value above 1023 in it.
        """
        inner = self._position
        while (inner := self._buffer.find(HEADER, inner + 1, self._position + self._size)) >= 0:
            if inner + self._size > len(self._buffer):
                return None
            if well_formed(np.frombuffer(self._buffer, self._record, 1, inner))[0]:
                self.counts.bad_time += 1
                self._claimed = self._size
                self._drop(1)
                return []
        return [ready for reading in self._accept(record, host_s) for ready in self._clock.judge(reading)]

    def _accept(self, records: NDArray[np.void], host_s: float) -> list[Reading]:
        self._position += len(records) * self._size
        self._claimed = 0
        self._in_refused_run = False
        pressures = self._geometry.pressure(records["raw"])
        times: list[int] = records["time"].tolist()
        return [Reading(ms, host_s, pressure) for ms, pressure in zip(times, pressures, strict=True)]

    def _refuse(self, *, value_too_high: bool) -> None:
        if not self._in_refused_run:
            if value_too_high:
                self.counts.bad_value += 1
            else:
                self.counts.bad_checksum += 1
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
