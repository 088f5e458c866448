"""Pads that print: one line of whole numbers a frame, bytes in, frames out, no I/O.

A line holds rows x columns raw values row by row, or the sensor's clock in milliseconds and then those;
numbers are separated by commas, semicolons, spaces or tabs, the line ends in LF or CR LF. Without a clock the
arrival time on the host stands in for it. A line has no checksum: a digit damaged into another digit goes
unnoticed. The first line after a (re)connect may be the second half of one, so it is never used. Whether
lines carry a clock is seen from the first whole one; three lines running that say otherwise change it.
"""

from __future__ import annotations

import numpy as np

from drivers.frame import MAX_COUNT, Counts, Frame
from drivers.pad.clock import ClockCheck
from drivers.pad.framing import CLOCK_MODULUS, Geometry, ProtocolCounts, Reading, number_frames

# A number has at most ten digits (the clock); the rest is room for separators and alignment.
MAX_CHARACTERS_A_NUMBER = 12
LINES_TO_CHANGE_LAYOUT = 3
SEPARATORS_TO_SPACES = bytes.maketrans(b",;", b"  ")


def encode_csv_line(
    counts: Counts,
    sensor_ms: int | None,
    rows: int = 10,
    columns: int = 10,
    crop: int = 1,
    invert: bool = True,
) -> bytes:
    """Return pressure (8, 8) as a pad would print it, with the clock first unless `sensor_ms` is None."""
    numbers: list[int] = Geometry(rows, columns, crop, invert).raw(counts).ravel().tolist()
    if sensor_ms is not None:
        numbers.insert(0, sensor_ms % CLOCK_MODULUS)
    return ",".join(map(str, numbers)).encode() + b"\n"


class CsvLines:
    """Parser for lines of numbers.

    Keeps at most one line of 12 characters a number between calls whatever comes in. Raises ProtocolError
    when rows, columns and crop do not leave 8x8 taxels; `feed` never raises.
    """

    def __init__(self, rows: int = 10, columns: int = 10, crop: int = 1, invert: bool = True) -> None:
        self._geometry = Geometry(rows, columns, crop, invert)
        self._longest_line = (self._geometry.taxels + 1) * MAX_CHARACTERS_A_NUMBER
        self.counts = ProtocolCounts()
        self._clock = ClockCheck(self.counts)
        self._half_line = b""
        self._skipping = True
        self._has_clock: bool | None = None
        self._lines_of_other_layout = 0

    @property
    def description(self) -> str:
        """What this parser expects, in words for a person."""
        return f"csv {self._geometry}"

    @property
    def pending_bytes(self) -> int:
        """Bytes kept until more arrive."""
        return len(self._half_line)

    def feed(self, data: bytes, host_s: float) -> list[Frame]:
        """Take bytes that arrived at `host_s` (monotonic seconds); return the frames they completed."""
        *lines, self._half_line = (self._half_line + data).split(b"\n")
        readings: list[Reading] = []
        for line in lines:
            if self._skipping:
                self._skipping = False
                self.counts.bytes_dropped += len(line) + 1
            else:
                readings += self._line(line, host_s)
        if len(self._half_line) > self._longest_line or self._skipping:
            self.counts.bytes_dropped += len(self._half_line)
            self.counts.bad_framing += not self._skipping
            self._half_line = b""
            self._skipping = True
        return number_frames(readings, self.counts)

    def reset(self) -> None:
        """Forget half a line and the clock after a reconnect; counts and frame numbers go on."""
        self.counts.bytes_dropped += len(self._half_line)
        self._half_line = b""
        self._skipping = True
        self._has_clock = None
        self._lines_of_other_layout = 0
        self._clock.reset()

    def _line(self, line: bytes, host_s: float) -> list[Reading]:
        words = line.translate(SEPARATORS_TO_SPACES).split()
        if not words:
            return []
        has_clock = len(words) == self._geometry.taxels + 1
        right_length = has_clock or len(words) == self._geometry.taxels
        numeric = len(line) <= self._longest_line and all(map(bytes.isdigit, words))
        if not (right_length and numeric and self._follow_layout(has_clock)):
            self.counts.bad_framing += 1
            self.counts.bytes_dropped += len(line) + 1
            return []
        numbers = [int(word) for word in words]
        values = numbers[1:] if has_clock else numbers
        if max(values) > MAX_COUNT or numbers[0] >= CLOCK_MODULUS:
            self.counts.bad_value += 1
            self.counts.bytes_dropped += len(line) + 1
            return []
        pressure = self._geometry.pressure(np.array(values, dtype=np.uint16))
        if has_clock:
            return self._clock.judge(Reading(numbers[0], host_s, pressure))
        return [Reading(int(host_s * 1000) % CLOCK_MODULUS, host_s, pressure)]

    def _follow_layout(self, has_clock: bool) -> bool:
        """Whether a line is of the layout followed; after three running that are not, theirs is followed."""
        if has_clock != self._has_clock and self._has_clock is not None:
            self._lines_of_other_layout += 1
            if self._lines_of_other_layout < LINES_TO_CHANGE_LAYOUT:
                return False
        self._has_clock = has_clock
        self._lines_of_other_layout = 0
        return True
