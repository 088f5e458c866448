"""Finds frames in lines with numbers: bytes in, values out.

Words, labels (`R0:`, `A7`, `Row 4:`), brackets, other punctuation and terminal escapes are skipped; `nan` and
`null` read 0. Lines end in LF, CR LF or CR. A frame is one line with all cells, or several lines with equally
many numbers each. Three things separate frames of several lines: a line with another count of numbers (a
word, a blank line), a row number that falls, or the text `end`. A frame is delivered only if exactly its
lines lie between two separators, so a damaged line spoils only its own frame. A line has no checksum: a digit
damaged into another digit goes unnoticed. The first line after a (re)connect may be half a line, so it is
never used.
"""

import re
from collections.abc import Sequence

import numpy as np

from touchd.drivers.frame import ProtocolCounts
from touchd.drivers.pad.format import PadFormat, RawFrame

# Room for a number with its label, separators and alignment, and for words beside the numbers of a line.
CHARACTERS_A_NUMBER, CHARACTERS_A_LINE = 24, 256
LINE_END = re.compile(rb"\r*\n\r*|\r+")
# What may stand between plain numbers; a line with anything else is read by TOKEN.
SEPARATORS = b",;|\t\"'[](){}<>$#!&@/\\~^`?"
PLAIN = bytes.maketrans(SEPARATORS + b"_nNiI", b" " * len(SEPARATORS) + b"\0" * 5)
TOKEN = re.compile(
    rb"""
      \x1b \[ [0-?]* [ -/]* [@-~] | \x1b .      # what clears the screen or sets a colour
    | \* [0-9A-Fa-f]{2} \s* $                   # a checksum after an asterisk, as NMEA has it
    | 0 [xX] (?P<hex> [0-9A-Fa-f]{1,8} ) \b | (?P<missing> nan \b | null \b )
    | (?! \d+ [eE] \d+ \b ) \d+ [A-Fa-f] [0-9A-Fa-f]* \b  # hexadecimal without 0x, which is not a number
    | [A-Za-z_]+ (?P<of_word> \d* ) [A-Za-z_]*  # a word, perhaps with a number: R0, A7
    | (?P<number> (?: (?<![\d.]) [-+] )? (?: \d+ \.? \d* | \. \d+ ) (?: [eE] [-+]? \d+ )? )
      [A-Za-z_]* (?P<is_label> ["')\]]? \s* [:=] )?
    """,
    re.VERBOSE | re.IGNORECASE,
)


def lines_in(text: bytes) -> list[bytes]:
    """Return the lines of a text that ends where a line ends; LF CR ends a line as CR LF does."""
    return LINE_END.split(text)[:-1]


def ended_at(text: bytes) -> int:
    """Return the end of the last complete line; a CR ends a line once something else follows."""
    return max(text.rfind(b"\n"), text.rstrip(b"\r").rfind(b"\r")) + 1


def numbers_in(line: bytes) -> tuple[list[float], int | None]:
    """Return a line's numbers, and the number in the label that it begins with, if any."""
    try:
        return list(map(float, line.translate(PLAIN).split())), None
    except ValueError:
        return _numbers_among_words(line)


def _numbers_among_words(line: bytes) -> tuple[list[float], int | None]:
    numbers: list[float] = []
    label = None
    for token in TOKEN.finditer(line):
        if token["number"]:
            if not token["is_label"]:
                numbers.append(float(token["number"]))
            elif not numbers and label is None and token["number"].isdigit():
                label = int(token["number"][:9])
        elif token["hex"] or token["missing"]:
            numbers.append(float(int(token["hex"] or "0", 16)))
        elif token["of_word"] and not numbers and label is None:
            label = int(token["of_word"][:9])
    return numbers, label


class TextFraming:
    """Finds frames in lines of numbers; the bytes that it keeps are limited by the frame's size."""

    def __init__(self, described: PadFormat, counts: ProtocolCounts) -> None:
        self._format = described
        self._counts = counts
        self._around = described.skip + described.tail
        self._longest = CHARACTERS_A_NUMBER * (described.cells + self._around) + CHARACTERS_A_LINE
        self._end = described.end.encode()
        self._run_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Skip the first line, which may be cut. The first run, too, may have begun before we listened."""
        self.buffer = b""
        self._skipping = self._is_first_run = True
        self._begin_run()

    def _begin_run(self) -> None:
        """Begin a run of lines: its cells, how many numbers each line has, and what led the last line."""
        self._run: list[float] = []
        self._run_width = 0
        self._run_leads: Sequence[float] = ()

    def feed(self, data: bytes, host_s: float) -> list[RawFrame]:
        """Take the next bytes; return the frames that they completed."""
        # Where a line begins, a CR belongs to the LF before it.
        text = (self.buffer + data).lstrip(b"\r")
        ended = ended_at(text)
        self.buffer = text[ended:]
        frames: list[RawFrame] = []
        for line in lines_in(text[:ended]):
            if self._skipping:
                self._skipping = False
            elif len(line) > self._longest:
                frames += self._give_up()
            else:
                frames += self._line(line, host_s)
        if len(self.buffer) > self._longest:
            frames += [] if self._skipping else self._give_up()
            self.buffer, self._skipping = b"", True
        return frames

    def _give_up(self) -> list[RawFrame]:
        """Refuse a line that cannot be one of the pad's."""
        self._counts.damaged += 1
        return self._end_run()

    def _line(self, line: bytes, host_s: float) -> list[RawFrame]:
        numbers, label = numbers_in(line)
        described = self._format
        count = len(numbers)
        if count == described.cells + self._around:
            ended = self._end_run()
            stop = count - described.tail
            return ended + self._frame(numbers[described.skip : stop], numbers[: described.skip], host_s)
        if self._end:
            return self._line_before_end(line, numbers, host_s)
        if 2 * count > described.cells + self._around:
            return self._give_up()
        leads = numbers[: described.skip] if label is None else [label, *numbers[: described.skip]]
        falls = any(now < before for now, before in zip(leads, self._run_leads, strict=False))
        ended = self._end_run() if count != self._run_width or falls else []
        if count > self._around:
            self._add(numbers, leads, host_s)
        return ended

    def _line_before_end(self, line: bytes, numbers: list[float], host_s: float) -> list[RawFrame]:
        """Take a line of a frame that ends with a text; lines without numbers may stand inside it."""
        if numbers:
            self._run_width = self._run_width or len(numbers)
            if len(numbers) == self._run_width:
                self._add(numbers, [], host_s)
            else:
                self._run = [0.0] * (self._format.cells + 1)
        return self._end_run() if line.rstrip().endswith(self._end) else []

    def _add(self, numbers: list[float], leads: Sequence[float], host_s: float) -> None:
        self._run_width, self._run_s, self._run_leads = len(numbers), host_s, leads
        # One surplus line shows that the run is not one frame.
        if len(self._run) <= self._format.cells:
            self._run += numbers[self._format.skip : len(numbers) - self._format.tail]

    def _end_run(self) -> list[RawFrame]:
        """Close the run of lines before this place; return the frame in it, if it is exactly one."""
        cells, host_s = self._run, self._run_s
        if not cells:
            return []
        is_broken = not self._is_first_run and self._run_width == self._format.columns + self._around
        self._begin_run()
        self._is_first_run = False
        if len(cells) == self._format.cells:
            return self._frame(cells, [], host_s)
        self._counts.damaged += is_broken
        return []

    def _frame(self, cells: list[float], skipped: Sequence[float], host_s: float) -> list[RawFrame]:
        return [RawFrame(skipped[0] if skipped else None, np.array(cells), max(cells), host_s)]
