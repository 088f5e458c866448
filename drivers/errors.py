"""The base class of touchd's errors: one printable line that says what is wrong and what to do.

Every error that a user can correct is a TouchdError; the command shows its message and exits with code 2.
Other errors are handled where they arise, or internal: exit code 1.
"""

import argparse
import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

MAX_LINE_BYTES = 4000
Number = TypeVar("Number", int, float)
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def one_line(text: str, max_bytes: int = MAX_LINE_BYTES) -> str:
    """Return text from anywhere as one printable line, cut to `max_bytes` of UTF-8.

    Characters that a terminal or a log could act on (newlines, escape sequences, changes of the writing
    direction, lone surrogates) become escapes such as \\n and \\x1b.
    """
    # Do not use a codec: it would be imported here, when no file descriptor may be left.
    escaped = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[:max_bytes])
    return escaped.encode()[:max_bytes].decode(errors="ignore")


def goes_to_systemd(fd: int) -> bool:
    """Return whether systemd's journal reads what is written to a file descriptor (systemd.exec(5))."""
    stream = os.environ.get("JOURNAL_STREAM")
    if stream is None:
        return False
    status = os.fstat(fd)
    return stream == f"{status.st_dev}:{status.st_ino}"


class TouchdError(Exception):
    """Something outside touchd is wrong: a file, a device, a setting, a network.

    The message is one line that says what is wrong, where, and what to do; the command line shows just that.
    Foreign text in it is escaped.
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def reason(error: Exception) -> str:
    """Return what an error says, without the number of an OSError."""
    return getattr(error, "strerror", None) or str(error)


@contextmanager
def os_errors_as(kind: type[TouchdError], what: str, advice: str = "") -> Iterator[None]:
    """Turn an OSError into a TouchdError that says what cannot be done, why, and what to do."""
    try:
        yield
    except OSError as error:
        raise kind(f"{what} ({reason(error)}){advice and f'; {advice}'}") from error


class PathError(TouchdError):
    """A path begins with an unknown home."""


def expand_home(path: str) -> Path:
    """Expand ~ and ~name at the beginning of a path; raises PathError if there is no such home."""
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise PathError(f"{path}: unknown home; set HOME, or write the whole path from / on") from error


def within(kind: type[Number], low: Number, high: Number) -> Callable[[str], Number]:
    """Return an argparse type: a number from `low` to `high`."""

    def number(text: str) -> Number:
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number from {low:g} to {high:g}")
        return value

    return number
