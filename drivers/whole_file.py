"""Writes a file whole or not at all, even if the power fails."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PARTIAL = ".partial-"
# Of what says something about people: recordings, the journal and what is made of them.
PRIVATE_MODE = 0o640
NO_LINKS = (errno.EPERM, errno.EACCES, errno.EOPNOTSUPP, errno.ENOSYS)


@contextmanager
def whole_file(path: Path, *, replace: bool = True, mode: int = 0o644) -> Iterator[Path]:
    """Yield a path beside `path` to write to; what was written takes the place of `path` at the end.

    replace: whether a file that is there is written over, keeping its owner and permissions; otherwise
    FileExistsError is raised. mode: what a new file permits at most. On any error nothing is left
    behind. Raises OSError.
    """
    partial = path.with_name(f"{PARTIAL}{path.name}")
    try:
        # Left by a program that was killed while it wrote.
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
    """Give the new file its name; raises FileExistsError where that is taken, unlike a renaming."""
    try:
        os.link(partial, path)
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        # USB sticks (FAT) and some shares have no links. Taking the name first would leave an empty file if
        # the program is killed before the next line.
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from error
        os.replace(partial, path)


def _take_over(path: Path, partial: Path) -> None:
    """Give the new file the owner and the permissions of the one that it replaces, if there is one."""
    try:
        before = path.stat()
    except FileNotFoundError:
        return
    try:
        os.chown(partial, before.st_uid, before.st_gid)
    except PermissionError:
        # Another's file that a group shares becomes ours, and stays the group's.
        if not os.access(path, os.W_OK):
            raise
        os.chown(partial, -1, before.st_gid)
    partial.chmod(before.st_mode & 0o7777)
