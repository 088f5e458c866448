"""This computer's addresses in its networks."""

import fcntl
import ipaddress
import socket
import struct
from contextlib import suppress

# ioctl(2), netdevice(7): the address of an interface.
SIOCGIFADDR = 0x8915


def own_addresses() -> list[str]:
    """Return this computer's IPv4 addresses, that of the default route first."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        # Connecting UDP sends nothing; the kernel only picks the source address.
        with suppress(OSError):
            asking.connect(("192.0.2.1", 9))
            found.append(asking.getsockname()[0])
        for _, name in socket.if_nameindex():
            with suppress(OSError):
                answer = fcntl.ioctl(asking.fileno(), SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
                found.append(socket.inet_ntoa(answer[20:24]))
    return [address for address in dict.fromkeys(found) if not ipaddress.ip_address(address).is_loopback]
