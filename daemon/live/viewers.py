"""The viewers of the live page: limits on their connections, and who may label touches."""

import asyncio
from collections.abc import Mapping
from ipaddress import IPv6Address
from typing import Annotated, Any

import msgspec
from websockets.asyncio.server import ServerConnection, broadcast
from websockets.protocol import State

from touchd.daemon.live.address import ip_of, name_in
from touchd.daemon.live.memory import Memory
from touchd.daemon.path.events import Count
from touchd.daemon.sinks.labels import Labeller

# Connections of any kind, including those for files and idle ones.
MOST_CONNECTIONS = 64
MOST_VIEWERS = 16
READ_BYTES = 4096
# Backlog, besides the kernel's buffer, above which a viewer gets no frames: about half a second.
FRAME_BACKLOG_BYTES = 4096
# Backlog above which a viewer is disconnected; its page reconnects and gets the state, which has some 800 kB
# for sixteen pads.
MOST_WAITING_BYTES = 1_000_000
# A web server in front of the page hides a viewer's address, and adds one of these headers.
FORWARDED = ("Forwarded", "X-Forwarded-For", "X-Real-IP", "Via")


class Connection(ServerConnection):
    """A connection that is closed if there are too many, and if it sends but does not read.

    Of too many, the oldest half-open one is closed, so that these cannot lock others out; without any, the
    new one. together: all connections, in order of arrival.
    """

    def __init__(self, together: dict["Connection", None], *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._together = together

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        # Of asyncio's 256 KiB, a client could make 40,000 frames at once.
        transport.max_size = READ_BYTES  # type: ignore[attr-defined]
        self._together[self] = None
        if len(self._together) > MOST_CONNECTIONS:
            half_open = (one for one in self._together if one.state is State.CONNECTING)
            next(half_open, self).transport.abort()

    def data_received(self, data: bytes) -> None:
        # Every ping is answered, whether or not the answers are read.
        if _waiting_bytes(self) > MOST_WAITING_BYTES:
            self.transport.abort()
        else:
            super().data_received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._together.pop(self, None)
        super().connection_lost(exc)


class Viewers(set[ServerConnection]):
    """Sends to all viewers; a slow one misses frames, one far behind is disconnected.

    Use in the event loop's thread only.
    """

    def send(self, message: str) -> None:
        """Send a message that no viewer may miss."""
        for viewer in [one for one in self if _waiting_bytes(one) > MOST_WAITING_BYTES]:
            viewer.transport.abort()
            self.discard(viewer)
        broadcast(self, message)

    def show(self, message: str | bytes) -> None:
        """Send a message that a slow viewer may miss."""
        broadcast((one for one in self if _waiting_bytes(one) <= FRAME_BACKLOG_BYTES), message)


def _waiting_bytes(viewer: ServerConnection) -> int:
    return viewer.transport.get_write_buffer_size()


class _Label(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A viewer's message: what a touch was."""

    pad: Annotated[str, msgspec.Meta(max_length=100)]
    touch: Count
    gesture: Annotated[str, msgspec.Meta(max_length=100)]


def take_label(
    labeller: Labeller, pads: Mapping[str, Memory], viewer: ServerConnection, message: str | bytes
) -> str:
    """Emit the label in a viewer's message; returns why the message is refused, or ""."""
    if not is_here(viewer):
        return "only this computer may say what a touch was"
    try:
        label = msgspec.json.decode(message, type=_Label)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return "not a label"
    touch = pads[label.pad].find(label.touch) if label.pad in pads else None
    if touch is None:
        return "no such touch"
    if label.gesture not in labeller.gestures[label.pad]:
        return "no such gesture"
    labeller.label(touch, label.gesture)
    return ""


def is_here(viewer: ServerConnection) -> bool:
    """Whether a viewer is on this computer, and asked for the page by a loopback name or address."""
    headers = viewer.request.headers if viewer.request else {}
    name = name_in(headers.get("Host", ""))
    is_forwarded = any(each in headers for each in FORWARDED)
    return (name == "localhost" or _is_here(name)) and _is_here(viewer.remote_address[0]) and not is_forwarded


def _is_here(address: str) -> bool:
    ip = ip_of(address)
    mapped = ip.ipv4_mapped if isinstance(ip, IPv6Address) else None
    return ip is not None and (mapped or ip).is_loopback
