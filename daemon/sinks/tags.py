"""Tags: what the person who runs trials says of them, as in participant=P07; they stand in every event."""

import errno
import logging
import os
import re
import socket
import threading
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
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
# Of the sockets of the service's daemons, of users' daemons, and of daemons without a folder of their own.
FOLDERS = ("/run/touchd*", "/run/user/*", "/tmp")


class TagError(TouchdError):
    """A tag cannot be used; the message is one line that says why."""


class Reply(msgspec.Struct):
    """A daemon's answer to a request for tags.

    config: the file of its settings, "" for the defaults. ports: of its pads. error: why nothing was changed.
    """

    config: str
    ports: list[str]
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
    """Return the folder for the socket of a daemon that this process is."""
    named = os.environ.get("RUNTIME_DIRECTORY") or os.environ.get("XDG_RUNTIME_DIR")
    return Path(named) if named and os.access(named, os.W_OK) else Path("/tmp")


def sockets() -> list[Path]:
    """Return the sockets of the daemons on this computer; only root reaches those of other users."""
    folders = (str(own_folder()), *FOLDERS)
    return sorted({Path(path) for folder in folders for path in glob(f"{folder}/touchd-*.socket")})


@contextmanager
def serving_tags(events: EventFanout, config: Path | None, ports: Sequence[str]) -> Iterator[None]:
    """Take tags from `touchd tag`, from this user and root, while the context lasts.

    config: the file of the daemon's settings, None for the defaults. ports: of its pads.
    """
    own = Reply(str(config.resolve()) if config else "", list(ports), {})
    # The user's number, as /tmp is everybody's.
    name = f"{os.geteuid()}-{zlib.crc32(own.config.encode()):08x}"
    path = own_folder() / f"touchd-{name}.socket"
    with ExitStack() as closing:
        listener = closing.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        try:
            _bind(listener, path)
        except OSError as error:
            log.warning("`touchd tag` will not work: %s: %s", path, error.strerror or error)
        else:
            thread = threading.Thread(target=_serve, args=(listener, events, own), name="touchd-tags")
            thread.daemon = True
            thread.start()
            closing.callback(path.unlink, missing_ok=True)
            closing.callback(thread.join, ANSWER_WITHIN_S)
            closing.callback(listener.shutdown, socket.SHUT_RDWR)
        yield


def _bind(listener: socket.socket, path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
        # A daemon that was killed leaves its socket.
        if client.connect_ex(str(path)) == errno.ECONNREFUSED:
            path.unlink()
    listener.bind(str(path))
    path.chmod(0o600)
    listener.listen()


def _serve(listener: socket.socket, events: EventFanout, own: Reply) -> None:
    with suppress(OSError):
        while True:
            connection, _ = listener.accept()
            with connection, suppress(OSError):
                connection.settimeout(ANSWER_WITHIN_S)
                connection.send(msgspec.json.encode(_answer(connection.recv(MOST_BYTES), events, own)))


def _answer(request: bytes, events: EventFanout, own: Reply) -> Reply:
    before = dict(events.tags)
    try:
        new = changed(before, msgspec.json.decode(request, type=list[str]))
    except (TagError, msgspec.DecodeError, RecursionError) as error:
        return msgspec.structs.replace(own, tags=before, error=str(error))
    if new != before:
        events.tags = new
        log.info("tags: %s", in_words(new))
    return msgspec.structs.replace(own, tags=new)
