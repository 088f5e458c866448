"""Tags: values that an experimenter puts into every event, as in participant=P07.

A running daemon holds a lock on NAME.lock, which describes the daemon, and has its tags in NAME.tags.
`touchd tag` replaces NAME.tags; the daemon reads it for each event.
"""

import fcntl
import logging
import os
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from glob import glob
from pathlib import Path

import msgspec

from touchd.daemon.sinks.sink import EventFanout
from touchd.drivers.errors import TouchdError
from touchd.drivers.whole_file import open_nonblocking, whole_file

log = logging.getLogger(__name__)

KEY = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,31}")
LONGEST_VALUE = 64
MOST_TAGS = 8
MOST_BYTES = 8192
OWN_MODE = 0o600
# Where the service, users, and daemons without a folder of their own have these files.
FOLDERS = ("/run/touchd*", "/run/user/*", "/tmp")


class TagError(TouchdError):
    """A tag cannot be used; the message is one line that says why."""


class RunningDaemon(msgspec.Struct, frozen=True):
    """A daemon on this computer. config: its configuration file, "" for the defaults. ports: of its pads."""

    config: str
    ports: list[str]


def changed(tags: Mapping[str, str], texts: Iterable[str]) -> dict[str, str]:
    """Return the tags as changed by KEY=VALUE texts; KEY= alone removes a tag. Raises TagError."""
    new = dict(tags)
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not KEY.fullmatch(key):
            raise TagError(
                f"{text!r} is not KEY=VALUE, as in participant=P07; a key begins with a letter and has "
                "letters, digits, - and _, 32 at most"
            )
        # LSL markers have slashes between their words.
        if not value.isprintable() or len(value) > LONGEST_VALUE or "/" in value:
            raise TagError(
                f"{key}: a value has {LONGEST_VALUE} printable characters at most, and no slash; shorten it"
            )
        new[key] = value
        if not value.strip():
            del new[key]
    if len(new) > MOST_TAGS:
        raise TagError(f"{len(new)} tags, {MOST_TAGS} at most; remove one with `touchd tag KEY=`")
    return new


def in_words(tags: Mapping[str, str]) -> str:
    return ", ".join(f"{key}={value}" for key, value in tags.items()) or "none"


def own_folder() -> Path:
    """Return the folder for this process's files."""
    named = os.environ.get("RUNTIME_DIRECTORY") or os.environ.get("XDG_RUNTIME_DIR")
    return Path(named) if named and os.access(named, os.W_OK) else Path("/tmp")


def running_daemons() -> dict[Path, RunningDaemon]:
    """Return the daemons on this computer by their files of tags; only root finds those of other users."""
    found = {}
    folders = (str(own_folder()), *FOLDERS)
    for path in sorted({path for folder in folders for path in glob(f"{folder}/touchd-*.lock")}):
        with suppress(OSError, msgspec.DecodeError), open(path, "rb", opener=open_nonblocking) as file:
            # In /tmp, another user may have put such a file.
            if os.geteuid() not in (0, os.fstat(file.fileno()).st_uid):
                continue
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                daemon = msgspec.json.decode(file.read(MOST_BYTES), type=RunningDaemon)
                found[Path(path).with_suffix(".tags")] = daemon
    return found


def read_tags(file: Path) -> dict[str, str]:
    """Return the tags in a daemon's file; raises OSError, and DecodeError if it holds none."""
    return msgspec.json.decode(file.read_bytes(), type=dict[str, str])


def write_tags(file: Path, tags: Mapping[str, str]) -> None:
    """Replace a daemon's tags; raises OSError."""
    with whole_file(file, mode=OWN_MODE) as new, new.open("xb") as opened:
        opened.write(msgspec.json.encode(tags))


@contextmanager
def serving_tags(
    events: EventFanout, tags: Mapping[str, str], config: Path | None, ports: Sequence[str]
) -> Iterator[None]:
    """Put tags into events until the context ends; `touchd tag`, run by this user or root, can change them.

    config: the daemon's configuration file, None for the defaults. ports: of its pads.
    """
    own = RunningDaemon(str(config.resolve()) if config else "", list(ports))
    # With the user's number, as all users share /tmp.
    lock = own_folder() / f"touchd-{os.geteuid()}-{zlib.crc32(own.config.encode()):08x}.lock"
    file = lock.with_suffix(".tags")

    def current() -> Mapping[str, str]:
        nonlocal tags
        # Without the file, or with a damaged one, the tags stay.
        with suppress(OSError, msgspec.DecodeError):
            before, tags = tags, read_tags(file)
            if tags != before:
                log.info("tags: %s", in_words(tags))
        return tags

    events.tags = lambda: tags
    with ExitStack() as closing:
        try:
            fd = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, OWN_MODE)
            closing.callback(os.close, fd)
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Writing to another user's file in /tmp would keep its owner.
            file.unlink(missing_ok=True)
            write_tags(file, tags)
            os.ftruncate(fd, 0)
            os.write(fd, msgspec.json.encode(own))
        except OSError as error:
            log.warning("`touchd tag` will not work: %s: %s", lock, error.strerror or error)
        else:
            events.tags = current
            closing.callback(file.unlink, missing_ok=True)
            closing.callback(lock.unlink, missing_ok=True)
        yield
