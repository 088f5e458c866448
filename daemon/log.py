"""The log of the daemon and its libraries: printable, limited in rate, written by its own thread."""

import logging
import threading
import time

from touchd.daemon.sinks import LinesSink
from touchd.drivers.errors import one_line

# Lines that one place in the code may log in this time: enough for sixteen pads, too few to fill a disk.
MOST_LINES = 60
WHILE_S = 60.0
MOST_TRACE_LINES = 100
LINE = logging.Formatter("%(levelname)s %(name)s: %(message)s")
_TRACE = logging.Formatter()


class LogGate(logging.Filter):
    """Makes each record printable, and limits how often one place in the code logs; debugging is not limited.

    The next line of a place says how many were left out; only its first in WHILE_S has a stack trace.
    """

    def __init__(self) -> None:
        super().__init__()
        self._lock = threading.Lock()
        self._places: dict[tuple[str, int], _Place] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        more = ""
        if record.levelno > logging.DEBUG:
            with self._lock:
                place = self._places.setdefault((record.pathname, record.lineno), _Place())
                if not place.may_log(time.monotonic()):
                    return False
                if place.left_out:
                    more, place.left_out = f" ({place.left_out} more like it were left out)", 0
                if place.lines > 1:
                    record.exc_info = record.exc_text = None
        record.msg, record.args = one_line(record.getMessage()) + more, None
        if record.exc_info and not record.exc_text:
            lines = _TRACE.formatException(record.exc_info).split("\n")
            # Indented, so that no line of an error's text can pass for one of the log.
            record.exc_text = "\n".join(f"  {one_line(line)}" for line in lines[-MOST_TRACE_LINES:])
        return True


class _Place:
    """A place in the code that logs. lines: in this WHILE_S. left_out: since the last line logged."""

    def __init__(self) -> None:
        self.lines = 0
        self.left_out = 0
        self._until_s = 0.0

    def may_log(self, now_s: float) -> bool:
        if now_s >= self._until_s:
            self.lines, self._until_s = 0, now_s + WHILE_S
        self.lines += 1
        if self.lines > MOST_LINES:
            self.left_out += 1
            return False
        return True


class LogWriter(logging.Handler):
    """Writes the records that the gate lets through to a file descriptor, in its own thread."""

    def __init__(self, fd: int) -> None:
        super().__init__()
        self.addFilter(LogGate())
        self._lines = LogLines(fd)
        self.start, self.stop = self._lines.start, self._lines.stop

    def emit(self, record: logging.LogRecord) -> None:
        self._lines.put(record)


class LogLines(LinesSink[logging.LogRecord]):
    """The lines of the log. If their reader is slow, the oldest are dropped; the next line says how many."""

    def __init__(self, fd: int) -> None:
        # The sink must not log into itself.
        unseen = logging.getLogger(f"{__name__}.unseen")
        unseen.disabled = True
        super().__init__("log", fd, lambda record: LINE.format(record).encode(errors="replace"), log=unseen)

    def _note_dropped(self) -> None:
        lost, self._dropped_before = self.dropped - self._dropped_before, self.dropped
        if lost:
            gap = f"{lost} lines of the log were dropped: nobody read them"
            self.write(logging.LogRecord(__name__, logging.WARNING, "", 0, gap, None, None))
