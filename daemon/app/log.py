"""The log of the daemon and its libraries: printable, limited in rate, written by its own thread."""

import logging
import time
from collections import Counter

from touchd.daemon.sinks.sink import LinesSink
from touchd.drivers.errors import one_line

# Lines that one place in the code may log in this time: enough for sixteen pads, too few to fill a disk.
MOST_LINES = 60
WHILE_S = 60.0
MOST_TRACE_LINES = 100
LINE = logging.Formatter("%(levelname)s %(name)s: %(message)s")
_TRACE = logging.Formatter()


class LogGate(logging.Filter):
    """Makes each record printable, and limits how often one place in the code logs; debugging is not limited.

    The last line that a place may log within WHILE_S says so; only the first has a stack trace.
    """

    def __init__(self) -> None:
        super().__init__()
        self._lines: Counter[tuple[str, int]] = Counter()
        self._until_s = 0.0

    def filter(self, record: logging.LogRecord) -> bool:
        more = ""
        if record.levelno > logging.DEBUG:
            # Threads that count at once may miss a line, which does no harm.
            if time.monotonic() >= self._until_s:
                self._lines.clear()
                self._until_s = time.monotonic() + WHILE_S
            place = (record.pathname, record.lineno)
            self._lines[place] += 1
            if self._lines[place] > MOST_LINES:
                return False
            if self._lines[place] == MOST_LINES:
                more = f" (more like it are left out for {WHILE_S:.0f} s)"
            if self._lines[place] > 1:
                record.exc_info = record.exc_text = None
        record.msg, record.args = one_line(record.getMessage()) + more, None
        if record.exc_info and not record.exc_text:
            lines = _TRACE.formatException(record.exc_info).split("\n")
            # Indented, so that no line of an error's text can pass for one of the log.
            record.exc_text = "\n".join(f"  {one_line(line)}" for line in lines[-MOST_TRACE_LINES:])
        return True


class LogWriter(logging.Handler):
    """Writes the records that the gate lets through to a file descriptor, in its own thread.

    If their reader is slow, the oldest are dropped.
    """

    def __init__(self, fd: int) -> None:
        super().__init__()
        self.addFilter(LogGate())
        # The sink must not log into itself.
        unseen = logging.getLogger(f"{__name__}.unseen")
        unseen.disabled = True
        self._lines = LinesSink("log", fd, _line, log=unseen)
        self.start, self.stop = self._lines.start, self._lines.stop

    def emit(self, record: logging.LogRecord) -> None:
        self._lines.put(record)


def _line(record: logging.LogRecord) -> bytes:
    return LINE.format(record).encode(errors="replace")
