"""Tags: what the person who runs trials says of them, as in participant=P07; they stand in every event."""

import logging
import os
import re
import socket
import struct
import threading
from collections.abc import Iterable, Mapping
from contextlib import suppress

import msgspec

from touchd.daemon.sinks.sink import EventFanout
from touchd.drivers.errors import TouchdError

log = logging.getLogger(__name__)

KEY = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,31}")
LONGEST_VALUE = 64
MOST_TAGS = 8
# In the kernel's own namespace, which needs no folder, and whose names go with their process.
ADDRESS = "\0touchd-tags-{pid}"
MOST_BYTES = 8192
ANSWER_WITHIN_S = 1.0
# What SO_PEERCRED returns: the process, its user and its group.
CREDENTIALS = struct.Struct("3i")


class TagError(TouchdError):
    """A tag cannot be used; the message is one line that says why."""


class Reply(msgspec.Struct):
    """The daemon's answer to a request for tags. error: why nothing was changed, or ""."""

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


def peer_of(connection: socket.socket) -> tuple[int, int]:
    """Return process and user at the other end of a Unix socket."""
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size)
    process, user, _ = CREDENTIALS.unpack(credentials)
    return process, user


class TagServer:
    """Takes tags from `touchd tag`, for this user and root, while the daemon runs. A context manager."""

    def __init__(self, events: EventFanout) -> None:
        self._events = events
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._thread = threading.Thread(target=self._serve, name="touchd-tags", daemon=True)

    def __enter__(self) -> "TagServer":
        try:
            self._socket.bind(ADDRESS.format(pid=os.getpid()))
            self._socket.listen()
            self._thread.start()
        except OSError as error:
            log.warning("`touchd tag` will not work: %s", error.strerror)
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        if self._thread.ident is not None:
            self._thread.join(ANSWER_WITHIN_S)

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._socket.accept()
                with connection, suppress(OSError):
                    connection.settimeout(ANSWER_WITHIN_S)
                    if peer_of(connection)[1] in (0, os.geteuid()):
                        connection.send(msgspec.json.encode(self._answer(connection.recv(MOST_BYTES))))

    def _answer(self, request: bytes) -> Reply:
        before = dict(self._events.tags)
        try:
            new = changed(before, msgspec.json.decode(request, type=list[str]))
        except (TagError, msgspec.DecodeError, RecursionError) as error:
            return Reply(before, str(error))
        if new != before:
            self._events.tags = new
            log.info("tags: %s", in_words(new))
        return Reply(new)
