"""The log of the daemon and its libraries: printable, limited in rate, written by its own thread."""

import logging
import time
from collections import Counter
from collections.abc import Callable

from touchd.daemon.sinks.sink import LinesSink
from touchd.drivers.errors import goes_to_systemd, one_line

# How many lines one place in the code may log in this interval: enough for sixteen pads, too few to fill
# a disk.
MOST_LINES = 60
INTERVAL_S = 60.0
MOST_TRACE_LINES = 100
LINE = logging.Formatter("%(levelname)s %(name)s: %(message)s")
# The numbers of syslog(3), by which `journalctl -p warning` selects.
SYSLOG_LEVELS = {logging.CRITICAL: 2, logging.ERROR: 3, logging.WARNING: 4, logging.INFO: 6, logging.DEBUG: 7}


class LogGate(logging.Filter):
    """Makes each record printable, and limits how often one place in the code logs; debugging is not limited.

    The last line that a place may log says so; only the first has a stack trace.
    """

    def __init__(self) -> None:
        super().__init__()
        self._lines: Counter[tuple[str, int]] = Counter()
        self._until_s = 0.0

    def filter(self, record: logging.LogRecord) -> bool:
        more = ""
        if record.levelno > logging.DEBUG:
            # Threads that count at the same time may miss a line, which does no harm.
            if time.monotonic() >= self._until_s:
                self._lines.clear()
                self._until_s = time.monotonic() + INTERVAL_S
            place = (record.pathname, record.lineno)
            self._lines[place] += 1
            if self._lines[place] > MOST_LINES:
                return False
            if self._lines[place] == MOST_LINES:
                more = f" (more like it are left out for {INTERVAL_S:.0f} s)"
            if self._lines[place] > 1:
                record.exc_info = record.exc_text = None
        record.msg, record.args = one_line(record.getMessage()) + more, None
        if record.exc_info and not record.exc_text:
            lines = LINE.formatException(record.exc_info).split("\n")
            # Indented, so that no line of an error's text looks like a line of the log.
            record.exc_text = "\n".join(f"  {one_line(line)}" for line in lines[-MOST_TRACE_LINES:])
        return True


class LogHandler(logging.Handler):
    """Hands the records that the gate lets through to `take`."""

    def __init__(self, take: Callable[[logging.LogRecord], None]) -> None:
        super().__init__()
        self.addFilter(LogGate())
        self._take = take

    def emit(self, record: logging.LogRecord) -> None:
        self._take(record)


class LogLines(LinesSink[logging.LogRecord]):
    """Writes log records to a file descriptor, in its own thread.

    If the reader is slow, the oldest are dropped; the next line says how many. For systemd's journal, each
    line begins with its level, as in <4> (sd-daemon(3)).
    """

    def __init__(self, fd: int) -> None:
        # The sink must not log into itself.
        unseen = logging.getLogger(f"{__name__}.unseen")
        unseen.disabled = True
        super().__init__("log", fd, self._line, log=unseen)
        self._dropped_before = 0
        self._is_journal = goes_to_systemd(fd)

    def _line(self, record: logging.LogRecord) -> bytes:
        lines = self._with_level(record)
        lost, self._dropped_before = self.dropped - self._dropped_before, self.dropped
        if lost:
            gap = f"{lost} lines of the log were dropped: nobody read them"
            before = logging.LogRecord(__name__, logging.WARNING, "", 0, gap, None, None)
            lines = f"{self._with_level(before)}\n{lines}"
        return lines.encode(errors="replace")

    def _with_level(self, record: logging.LogRecord) -> str:
        lines = LINE.format(record)
        if not self._is_journal:
            return lines
        level = SYSLOG_LEVELS.get(record.levelno, SYSLOG_LEVELS[logging.INFO])
        return "\n".join(f"<{level}>{line}" for line in lines.split("\n"))
