"""Tags: what the person who runs trials says of them, as in participant=P07; they stand in every event."""

import errno
import logging
import os
import re
import socket
import threading
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from glob import glob
from pathlib import Path

import msgspec

from touchd.daemon.sinks.sink import EventFanout
from touchd.drivers.errors import TouchdError

log = logging.getLogger(__name__)

KEY = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,31}")
LONGEST_VALUE = 64
MOST_TAGS = 8
MOST_BYTES = 8192
ANSWER_WITHIN_S = 1.0
# Where the daemons of systemd and of root have their sockets, and those of other users.
SERVICES = ("/run/touchd*",)
OTHERS = ("/run/user/*/touchd", "/tmp/touchd-*")


class TagError(TouchdError):
    """A tag cannot be used; the message is one line that says why."""


class Reply(msgspec.Struct):
    """A daemon's answer to a request for tags.

    config: the file of its settings, "" for the defaults. error: why nothing was changed, or "".
    """

    config: str
    tags: dict[str, str]
    error: str = ""


def changed(tags: Mapping[str, str], texts: Iterable[str]) -> dict[str, str]:
    """Return tags after these KEY=VALUE; KEY= alone removes a tag. Raises TagError."""
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
    """Return the folder for the socket of a daemon that this process is: only its user and root read it."""
    if service := os.environ.get("RUNTIME_DIRECTORY"):
        return Path(service.partition(":")[0])
    session = Path(os.environ.get("XDG_RUNTIME_DIR") or "/nonexistent")
    # With sudo -E it is another user's.
    if session.is_dir() and session.stat().st_uid == os.geteuid():
        return session / "touchd"
    if os.geteuid() == 0:
        return Path("/run/touchd")
    return Path(f"/tmp/touchd-{os.geteuid()}")


def sockets() -> list[Path]:
    """Return the sockets of the daemons that this user may reach: root reaches every user's."""
    folders = (str(own_folder()), *SERVICES, *(OTHERS if os.geteuid() == 0 else ()))
    return sorted({Path(path) for folder in folders for path in glob(f"{folder}/*.socket")})


class TagServer:
    """Takes tags from `touchd tag`, for this user and root, while the daemon runs. A context manager.

    config: the file of the daemon's settings, after which the socket is named; None for the defaults.
    """

    def __init__(self, events: EventFanout, config: Path | None) -> None:
        self._events = events
        self._config = str(config.resolve()) if config is not None else ""
        digest = f"{zlib.crc32(self._config.encode()):08x}"
        self._path = own_folder() / f"{digest}.socket"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._thread = threading.Thread(target=self._serve, name="touchd-tags", daemon=True)

    def __enter__(self) -> "TagServer":
        try:
            self._bind()
            self._socket.listen()
            self._thread.start()
        except OSError as error:
            log.warning("`touchd tag` will not work: %s: %s", self._path, error.strerror or error)
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        if self._thread.ident is not None:
            self._thread.join(ANSWER_WITHIN_S)
            with suppress(OSError):
                self._path.unlink()

    def _bind(self) -> None:
        folder = self._path.parent
        folder.mkdir(mode=0o700, exist_ok=True)
        if folder.stat().st_uid not in (0, os.geteuid()):
            # In /tmp, somebody else may have made it.
            raise PermissionError(errno.EPERM, "the folder is another user's")
        if self._path.exists() and not _is_served(self._path):
            # A daemon that was killed left it.
            self._path.unlink()
        self._socket.bind(str(self._path))
        self._path.chmod(0o600)

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._socket.accept()
                with connection, suppress(OSError):
                    connection.settimeout(ANSWER_WITHIN_S)
                    connection.send(msgspec.json.encode(self._answer(connection.recv(MOST_BYTES))))

    def _answer(self, request: bytes) -> Reply:
        before = dict(self._events.tags)
        try:
            new = changed(before, msgspec.json.decode(request, type=list[str]))
        except (TagError, msgspec.DecodeError, RecursionError) as error:
            return Reply(self._config, before, str(error))
        if new != before:
            self._events.tags = new
            log.info("tags: %s", in_words(new))
        return Reply(self._config, new)


def _is_served(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
        return connection.connect_ex(str(path)) != errno.ECONNREFUSED
