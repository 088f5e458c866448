"""Pads that print: lines of whole numbers, bytes in, frames out, no I/O.

Numbers are separated by commas, semicolons, spaces or tabs; lines end in LF or CR LF. A line has no checksum:
a digit damaged into another digit goes unnoticed. The first line, or the first frame of rows, after a
(re)connect may be the second half of one, so it is never used. Whether a line with all cells carries a clock
is seen from the first whole one; three lines running that say otherwise change it.
"""

import re

import numpy as np

from touchd.drivers.frame import CLOCK_MODULUS
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.framing import Reading
from touchd.drivers.pad.parser import FrameParser

# A number has at most ten digits (the clock); the rest is room for separators and alignment.
MAX_CHARACTERS_A_NUMBER = 12
# Python refuses to read a longer number.
MOST_DIGITS = 4300
LINES_TO_CHANGE_LAYOUT = 3
MOST_BLANKS = 8
BLANK = b"[ \\t\\r]{0,%d}" % MOST_BLANKS
SEPARATORS_TO_SPACES = bytes.maketrans(b",;", b"  ")


class TextFrames(FrameParser):
    """Parser for lines of numbers; keeps at most 12 characters a number between calls whatever comes in."""

    def __init__(self, described: PadFormat) -> None:
        super().__init__(described)
        self._is_line = described.framing == "line"
        end = BLANK + re.escape(described.end.encode()) + BLANK
        self._end = re.compile(b"\n" if self._is_line else b"\n" + end + b"\n")
        self._longest = (described.cells + 1) * MAX_CHARACTERS_A_NUMBER
        self._skipping = True
        self._has_clock: bool | None = None
        self._lines_of_other_layout = 0

    def _parse(self, data: bytes, host_s: float) -> list[Reading]:
        *blocks, self._buffer = self._end.split(self._buffer + data)
        readings: list[Reading] = []
        for block in blocks:
            if self._skipping:
                self._skipping = False
                self.counts.bytes_dropped += len(block) + 1
            else:
                readings += self._block(block, host_s)
        if len(self._buffer) > self._longest or self._skipping:
            # The end of a frame of rows may have begun in what is given up.
            kept = 0 if self._is_line else min(len(self._buffer), len(self.format.end) + 2 * MOST_BLANKS + 1)
            given_up = len(self._buffer) - kept
            self._buffer = self._buffer[given_up:]
            self.counts.bytes_dropped += given_up
            self.counts.bad_framing += not self._skipping
            self._skipping = True
        return readings

    def reset(self) -> None:
        super().reset()
        self._skipping = True
        self._has_clock = None
        self._lines_of_other_layout = 0

    def _block(self, block: bytes, host_s: float) -> list[Reading]:
        lines = [line.split() for line in block.translate(SEPARATORS_TO_SPACES).split(b"\n")]
        words = [word for line in lines for word in line]
        if not words:
            return []
        described = self.format
        if self._is_line:
            has_clock = len(words) == described.cells + 1
            right_length = has_clock or len(words) == described.cells
        else:
            has_clock = False
            right_length = [len(line) for line in lines if line] == [described.columns] * described.rows
        numeric = all(map(bytes.isdigit, words)) and len(max(words, key=len)) <= MOST_DIGITS
        if not (right_length and numeric and len(block) <= self._longest and self._follow_layout(has_clock)):
            self.counts.refuse("bad_framing", len(block) + 1)
            return []
        numbers = [int(word) for word in words]
        values = numbers[1:] if has_clock else numbers
        if max(values) > described.full_scale or numbers[0] >= CLOCK_MODULUS:
            self.counts.refuse("bad_value", len(block) + 1)
            return []
        return self._judge(numbers[0] if has_clock else None, host_s, np.array(values, dtype=np.uint16))

    def _follow_layout(self, has_clock: bool) -> bool:
        """Whether a line is of the layout followed; after three running that are not, theirs is followed."""
        if has_clock != self._has_clock and self._has_clock is not None:
            self._lines_of_other_layout += 1
            if self._lines_of_other_layout < LINES_TO_CHANGE_LAYOUT:
                return False
        self._has_clock = has_clock
        self._lines_of_other_layout = 0
        return True
