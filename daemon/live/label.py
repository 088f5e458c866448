"""Messages from viewers on this computer who say what a touch was (`live.label`)."""

from collections.abc import Mapping
from ipaddress import IPv6Address
from typing import Annotated

import msgspec
from websockets.asyncio.server import ServerConnection

from touchd.daemon.live.address import ip_of, name_in
from touchd.daemon.live.memory import Memory
from touchd.daemon.path.events import Count
from touchd.daemon.sinks.labels import Labeller

# A web server in front of the page hides where a viewer is; it adds one of these.
FORWARDED = ("Forwarded", "X-Forwarded-For", "X-Real-IP", "Via")


class _Said(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a touch was."""

    pad: Annotated[str, msgspec.Meta(max_length=100)]
    touch: Count
    gesture: Annotated[str, msgspec.Meta(max_length=100)]


_decode = msgspec.json.Decoder(_Said).decode


def take_label(
    labeller: Labeller, pads: Mapping[str, Memory], viewer: ServerConnection, message: str | bytes
) -> str:
    """Emit the label in a viewer's message; returns why the message is refused, or ""."""
    if not is_here(viewer):
        return "only this computer may say what a touch was"
    try:
        said = _decode(message)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return "not a label"
    touch = pads[said.pad].find(said.touch) if said.pad in pads else None
    if touch is None:
        return "no such touch"
    if said.gesture not in labeller.gestures[said.pad]:
        return "no such gesture"
    labeller.label(touch, said.gesture)
    return ""


def is_here(viewer: ServerConnection) -> bool:
    """Whether a viewer is on this computer, and asked for the page by a name of this computer alone."""
    headers = viewer.request.headers if viewer.request else {}
    name = name_in(headers.get("Host", ""))
    is_forwarded = any(each in headers for each in FORWARDED)
    return (name == "localhost" or _is_here(name)) and _is_here(viewer.remote_address[0]) and not is_forwarded


def _is_here(address: str) -> bool:
    ip = ip_of(address)
    mapped = ip.ipv4_mapped if isinstance(ip, IPv6Address) else None
    return ip is not None and (mapped or ip).is_loopback
