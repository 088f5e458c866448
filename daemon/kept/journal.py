"""The file of events: each line whole or not at all, rotated by size, so that it never fills a disk."""

from __future__ import annotations

import errno
import logging
import os
from pathlib import Path

from drivers.errors import TouchdError

log = logging.getLogger(__name__)

MAX_LINE_BYTES = 64 * 1024
# A process that is killed while it writes leaves whole pages: Linux looks for the signal between them. So no
# event may cross one; the line before is filled up with blanks, which JSON ignores.
PAGE_BYTES = 4096
MAX_EVENT_BYTES = 1024


class JournalError(TouchdError):
    """The journal cannot be opened; the message is one line that says why."""


class Journal:
    """Appends lines to a file; a full disk is warned of once and costs lines, never the daemon.

    path: the file; older ones are path.1 (the newest) to path.`keep`. max_bytes: size at which a new file is
    begun. Raises JournalError when the file cannot be opened.
    """

    def __init__(self, path: Path, *, max_bytes: int, keep: int) -> None:
        self._path = path
        self._max_bytes = max_bytes
        self._keep = keep
        self._failing = False
        self.lost = 0
        try:
            self._fd, self._size = _open(path)
        except OSError as error:
            raise JournalError(
                f"journal {path}: cannot be written ({error.strerror}); give another journal.path, or null"
            ) from error

    def append(self, line: bytes) -> None:
        """Write one line, given without its newline; when that fails it is counted in `lost`."""
        try:
            if self._size and self._size + len(line) + 1 > self._max_bytes:
                self._rotate()
            self._write(line + b" " * self._blanks_after(line) + b"\n")
        except OSError as error:
            self.lost += 1
            level = logging.DEBUG if self._failing else logging.WARNING
            log.log(
                level, "journal %s: %s; events are not kept until that is mended", self._path, error.strerror
            )
            self._failing = True
        else:
            if self._failing:
                log.info("journal %s: works again; %d events were lost", self._path, self.lost)
            self._failing = False

    def close(self) -> None:
        """Close the file; further lines are lost."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _blanks_after(self, line: bytes) -> int:
        """Return how many blanks keep the next event from crossing into another page."""
        room = -(self._size + len(line) + 1) % PAGE_BYTES
        fits = self._size + len(line) + 1 + room <= self._max_bytes
        return room if room < MAX_EVENT_BYTES and fits else 0

    def _write(self, data: bytes) -> None:
        written = os.write(self._fd, data)
        if written < len(data):
            os.ftruncate(self._fd, self._size)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._size += written

    def _rotate(self) -> None:
        # An attempt that moved the files but could not open the next must not move them once more.
        if self._path.exists():
            for number in range(self._keep, 0, -1):
                older = self._numbered(number - 1)
                if older.exists():
                    os.replace(older, self._numbered(number))
            if self._keep == 0:
                self._path.unlink()
        fd, size = _open(self._path)
        self.close()
        self._fd, self._size = fd, size

    def _numbered(self, number: int) -> Path:
        return self._path.with_name(f"{self._path.name}.{number}") if number else self._path


def _open(path: Path) -> tuple[int, int]:
    """Return the file open for appending, and its size; half a line left by a power cut is taken off."""
    fd = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK, 0o640)
    try:
        size = os.fstat(fd).st_size
        start = max(0, size - MAX_LINE_BYTES)
        tail = os.pread(fd, size - start, start)
        if tail and not tail.endswith(b"\n"):
            size = start + tail.rfind(b"\n") + 1
            os.ftruncate(fd, size)
    except OSError:
        os.close(fd)
        raise
    return fd, size
