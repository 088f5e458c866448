"""The log of the daemon and its libraries: printable, limited in rate, written by its own thread."""

import logging
import queue
import threading
import time
from contextlib import suppress
from logging.handlers import QueueHandler, QueueListener
from typing import Any

from touchd.daemon.sinks import written_in_pieces
from touchd.drivers.errors import one_line

# Lines that one place in the code may log in this time: enough for sixteen pads, too few to fill a disk.
MOST_LINES = 60
WHILE_S = 60.0
MOST_TRACE_LINES = 100
# Records that wait for a slow reader of the log.
CAPACITY = 1000
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


class LogWriter(QueueHandler):
    """Writes the records that the gate lets through to a file descriptor, in its own thread.

    If the reader is slow or gone, records are dropped and the daemon goes on. The next line says how many.
    """

    def __init__(self, fd: int, capacity: int = CAPACITY) -> None:
        self._waiting: queue.Queue[Any] = queue.Queue(capacity)
        super().__init__(self._waiting)
        self.addFilter(LogGate())
        self.dropped = 0
        self._fd = fd
        self._abandoned = threading.Event()
        writer = logging.Handler()
        writer.emit = self._write  # type: ignore[method-assign]
        self._listener = _Listener(self._waiting, writer)

    def start(self) -> None:
        self._listener.start()

    def stop(self, timeout_s: float) -> None:
        """Write what is queued, for at most `timeout_s`."""
        giving_up = threading.Timer(timeout_s, self._abandoned.set)
        giving_up.start()
        self._listener.stop()
        giving_up.cancel()

    def enqueue(self, record: logging.LogRecord) -> None:
        try:
            if self.dropped:
                gap = f"{self.dropped} lines of the log were dropped: nobody read them"
                self._waiting.put_nowait(logging.LogRecord(__name__, logging.WARNING, "", 0, gap, None, None))
                self.dropped = 0
            self._waiting.put_nowait(record)
        except queue.Full:
            self.dropped += 1

    def _write(self, record: logging.LogRecord) -> None:
        data = f"{LINE.format(record)}\n".encode(errors="replace")
        # A full disk, or a reader that is gone.
        with suppress(OSError):
            for _ in written_in_pieces(self._fd, data, self._abandoned):
                pass


class _Listener(QueueListener):
    """A QueueListener whose end marker waits for room in the queue."""

    def enqueue_sentinel(self) -> None:
        assert isinstance(self.queue, queue.Queue)
        self.queue.put(None)
