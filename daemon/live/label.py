"""Messages from viewers on this computer who say what a touch was (`live.label`)."""

import ipaddress
from collections.abc import Mapping
from typing import Annotated

import msgspec
from websockets.asyncio.server import ServerConnection

from touchd.daemon.live.memory import Memory
from touchd.daemon.path.events import Count
from touchd.daemon.sinks.labels import LabelError, Labeller

# A web server in front of the page hides where a viewer is; it adds one of these.
FORWARDED = ("Forwarded", "X-Forwarded-For", "X-Real-IP", "Via")


class _Said(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a touch was."""

    pad: Annotated[str, msgspec.Meta(max_length=100)]
    touch: Count
    gesture: Annotated[str, msgspec.Meta(max_length=100)]


_decode = msgspec.json.Decoder(_Said).decode


class Labels:
    """Takes labels from viewers on this computer. pads: whose touches are shown."""

    def __init__(self, labeller: Labeller, pads: Mapping[str, Memory]) -> None:
        self._labeller = labeller
        self._pads = pads

    def take(self, viewer: ServerConnection, message: str | bytes) -> str:
        """Emit the label in a viewer's message; returns why the message is refused, or ""."""
        if not is_here(viewer):
            return "only this computer may say what a touch was"
        try:
            said = _decode(message)
        except (msgspec.DecodeError, UnicodeDecodeError):
            return "not a label"
        touch = self._pads[said.pad].find(said.touch) if said.pad in self._pads else None
        if touch is None:
            return "no such touch"
        try:
            self._labeller.label(touch, said.gesture)
        except LabelError:
            return "no such gesture"
        return ""


def is_here(viewer: ServerConnection) -> bool:
    """Whether a viewer is on this computer, and asked for the page by a name of this computer alone."""
    headers = viewer.request.headers if viewer.request else {}
    host = headers.get("Host", "").rpartition(":")[0] or headers.get("Host", "")
    is_named_here = host == "localhost" or _is_loopback(host.strip("[]"))
    return (
        _is_loopback(viewer.remote_address[0])
        and is_named_here
        and not any(name in headers for name in FORWARDED)
    )


def _is_loopback(address: str) -> bool:
    try:
        ip = ipaddress.ip_address(address)
    except ValueError:
        return False
    mapped = ip.ipv4_mapped if isinstance(ip, ipaddress.IPv6Address) else None
    return (mapped or ip).is_loopback
