"""What is checked of the configuration of several pads: their number, names and ports."""

import os
import re
from collections.abc import Mapping

MAX_PADS = 16


def check(ports: Mapping[str, str], *, needs_ascii: bool) -> None:
    """Raise ValueError if pads cannot be told apart. ports: by name. needs_ascii: for other systems."""
    if len(ports) > MAX_PADS:
        raise ValueError(f"sensors: {len(ports)} pads, {MAX_PADS} at most; run another touchd")
    for name in ports:
        if not re.fullmatch(r"[A-Za-z]\w{0,31}", name):
            raise ValueError(f"sensors: invalid pad name {name!r}; use one word such as left_arm")
        if not name.isascii() and needs_ascii:
            raise ValueError(f"sensors: {name}: ROS and Home Assistant take only a to z, 0 to 9 and _")
    named: dict[str, str] = {}
    for port in ports.values():
        # A port of UDP is one, at whichever of this computer's addresses.
        address = re.sub(r"^udp://.*:", "udp://:", port.lower())
        device = address if "://" in address else os.path.realpath(port)
        other = named.get(device)
        if other is not None:
            same = f", the same device as {other}," if other != port else ""
            raise ValueError(f"sensors: {port}{same} is the port of more than one pad; give each its own")
        named[device] = port
