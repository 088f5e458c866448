"""Writes files atomically, even across a power failure; reads files, and secrets, without blocking."""

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from touchd.drivers.errors import TouchdError, expand_home, reason

PARTIAL = ".partial-"
# For files about people: recordings, the journal, and what is derived from them.
PRIVATE_MODE = 0o640
# In characters. A larger file is not a secret, and must not be sent.
MOST_SECRET = 4096
NO_LINKS = (errno.EPERM, errno.EACCES, errno.EOPNOTSUPP, errno.ENOSYS)


@contextmanager
def whole_file(path: Path, *, replace: bool = True, mode: int = 0o644) -> Iterator[Path]:
    """Yield a path beside `path` to write to; at the end that file takes the name `path`.

    replace: replace an existing file and keep its owner and permissions; otherwise raise FileExistsError.
    mode: upper bound of a new file's permissions. Any error leaves no file behind. Raises OSError.
    """
    partial = path.with_name(f"{PARTIAL}{path.name}")
    try:
        # A killed program may have left one.
        partial.unlink(missing_ok=True)
        yield partial
        partial.chmod(partial.stat().st_mode & mode)
        with partial.open("rb") as file:
            os.fsync(file.fileno())
        if replace:
            _take_over(path, partial)
            os.replace(partial, path)
        else:
            _put_beside_none(path, partial)
    finally:
        partial.unlink(missing_ok=True)


def _put_beside_none(path: Path, partial: Path) -> None:
    """Give the new file its name; unlike os.replace, raises FileExistsError if the name is taken."""
    try:
        os.link(partial, path)
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        # FAT (USB sticks) and some shares have no hard links. Creating `path` first, to reserve it, would
        # leave an empty file if the program is killed before the next line.
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from error
        os.replace(partial, path)


def _take_over(path: Path, partial: Path) -> None:
    """Copy owner and permissions from the file to be replaced, if there is one."""
    if not path.exists():
        return
    before = path.stat()
    try:
        os.chown(partial, before.st_uid, before.st_gid)
    except PermissionError:
        # A file shared by a group: the owner changes to us, the group stays.
        if not os.access(path, os.W_OK):
            raise
        os.chown(partial, -1, before.st_gid)
    partial.chmod(before.st_mode & 0o7777)


def open_nonblocking(path: str, flags: int) -> int:
    """Open a file to read, as `open`'s opener: an unconnected pipe reads as empty, a device is refused."""
    fd = os.open(path, flags | os.O_NONBLOCK)
    mode = os.fstat(fd).st_mode
    if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
        os.close(fd)
        raise OSError(errno.EINVAL, "Is a device", path)
    os.set_blocking(fd, True)
    return fd


def secret_in(file: str, setting: str, kind: type[TouchdError]) -> str:
    """Return the password or token in a file; raises `kind` with the setting that names the file."""
    try:
        # An editor on Windows may write a byte order mark.
        with open(expand_home(file), encoding="utf-8-sig", opener=open_nonblocking) as opened:
            secret = opened.read(MOST_SECRET + 1).strip()
    except (OSError, UnicodeDecodeError) as error:
        raise kind(f"{setting} {file} cannot be read ({reason(error)}); check path and owner") from error
    if not 0 < len(secret) <= MOST_SECRET:
        raise kind(f"{setting} {file} is empty or too large; put the password or token there")
    return secret
