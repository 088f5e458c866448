"""The file of events: each line is written whole or not at all; rotation by size limits the space."""

import errno
import fcntl
import logging
import os
from itertools import pairwise
from pathlib import Path

from touchd.daemon.app.config import JournalSettings
from touchd.daemon.path.events import Event, encode
from touchd.daemon.sinks.sink import QueuedSink
from touchd.drivers.errors import TouchdError, os_errors_as

log = logging.getLogger(__name__)

# Size of a file, for some five thousand touches, and the number of older files that are kept.
MAX_BYTES, OLDER = 10_000_000, 5
MAX_LINE_BYTES = 64 * 1024
# The beginning of every line.
FIRST_BYTES = b'{"type":"'


class JournalError(TouchdError):
    """The journal cannot be opened; the message is one line that says why."""


class Journal(QueuedSink[Event]):
    """Appends each event to a file as a line of JSON. On a full disk lines are lost, with one warning.

    path: the file; older ones are path.1 (the newest) to path.`keep`. max_bytes: size at which a new file
    begins. Only one process may write a journal. Raises JournalError if the file cannot be opened or is not a
    journal.
    """

    def __init__(self, path: Path, *, max_bytes: int = MAX_BYTES, keep: int = OLDER) -> None:
        super().__init__("journal", log)
        self._max_bytes = max_bytes
        self._keep = keep
        self.lost = 0
        advice = "give another journal.path, or null"
        with os_errors_as(JournalError, f"journal {path}: cannot be written", advice):
            # Resolve symlinks, so that rotation stays on the target's disk.
            self._path = Path(os.path.realpath(path))
            self._fd = _open(self._path)

    def write(self, item: Event) -> None:
        self.append(encode(item))

    def append(self, line: bytes) -> None:
        """Write one line, given without its newline; when that fails it is counted in `lost`."""
        try:
            if not self._is_there():
                self._begin_file()
                log.warning("journal %s: was removed; created a new file", self._path)
            size = os.fstat(self._fd).st_size
            if size and size + len(line) + 1 > self._max_bytes:
                self._rotate()
                size = os.fstat(self._fd).st_size
            if os.write(self._fd, line + b"\n") <= len(line):
                os.ftruncate(self._fd, size)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except (JournalError, OSError) as error:
            self.lost += 1
            cause = f"{self._path}: {error.strerror}" if isinstance(error, OSError) else str(error)
            self._faults.begin("lost", f"{cause}; events cannot be saved", cause=cause)
        else:
            self._faults.end("lost", f"{self._path}: works again; {self.lost} events were lost")

    def stop(self, timeout_s: float) -> None:
        super().stop(timeout_s)
        # If the disk hangs, the thread may still write: leave the file open.
        if not self._thread.is_alive():
            self.close()

    def close(self) -> None:
        """Close the file; further lines are lost."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _is_there(self) -> bool:
        """Whether the path still leads to the open file; raises OSError if that cannot be determined."""
        try:
            return os.path.samestat(os.stat(self._path), os.fstat(self._fd))
        except FileNotFoundError:
            return False

    def _rotate(self) -> None:
        # Do not move the files again if an earlier attempt moved them but could not open the new one.
        if self._path.exists():
            files = journal_files(self._path, self._keep)
            for newer, older in reversed(list(pairwise(files))):
                if newer.exists():
                    os.replace(newer, older)
        self._begin_file()

    def _begin_file(self) -> None:
        fd = _open(self._path)
        self.close()
        self._fd = fd


def journal_files(path: Path, keep: int = OLDER) -> list[Path]:
    """Return the paths of a journal and of its older files, path.1 to path.`keep`, the newest first."""
    return [path, *(path.with_name(f"{path.name}.{number}") for number in range(1, keep + 1))]


def open_journal(settings: JournalSettings) -> Journal:
    """Return the configured journal; raises JournalError. The default folder is made if it is missing."""
    path = settings.file
    if settings.path is None:
        with os_errors_as(JournalError, f"journal {path}: cannot be written", "set journal: null"):
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    return Journal(path)


def _open(path: Path) -> int:
    """Open the file for appending, by this process alone, and cut off half a line that a power cut left."""
    # Opening a device or a pipe may have an effect.
    if path.exists() and not path.is_file():
        raise JournalError(f"journal {path}: is not a file; give another journal.path")
    fd = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK, 0o640)
    try:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise JournalError(f"journal {path}: another touchd writes it; give each its own") from error
        size = os.fstat(fd).st_size
        begin = os.pread(fd, len(FIRST_BYTES), 0)
        if begin.strip(b"\0") and not FIRST_BYTES.startswith(begin):
            raise JournalError(
                f"journal {path}: is not a journal of touchd; it was left as it is; give another journal.path"
            )
        start = max(0, size - MAX_LINE_BYTES)
        tail = os.pread(fd, size - start, start)
        if tail and not tail.endswith(b"\n"):
            os.ftruncate(fd, start + tail.rfind(b"\n") + 1)
    except (OSError, JournalError):
        os.close(fd)
        raise
    return fd
