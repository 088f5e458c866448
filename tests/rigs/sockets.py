"""A free port, and the network sockets of a process as Linux lists them."""

import itertools
import os
import socket
from contextlib import suppress
from pathlib import Path

LISTENS = "0A"
LOOPBACK = "0100007F"
# Below the kernel's ephemeral ports, so that no other program is given one; each test process starts
# elsewhere.
_ports = itertools.count(10_000 + os.getpid() * 977 % 20_000)
_reserved: list[socket.socket] = []


def free_port() -> int:
    """A free port of loopback. Until this process ends, no other process gets it from here.

    It stays bound by a socket that does not listen: servers, which set SO_REUSEADDR, can bind it as well.
    """
    for port in _ports:
        reserved = socket.socket()
        try:
            reserved.bind(("127.0.0.1", port))
        except OSError:
            reserved.close()
            continue
        reserved.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        _reserved.append(reserved)
        return port
    raise AssertionError


def sockets(pid: int) -> list[tuple[str, str, str]]:
    """Return protocol, local address and state, as proc(5) writes them, of a process's network sockets."""
    links = []
    for link in Path(f"/proc/{pid}/fd").iterdir():
        # The process may close it after it was listed.
        with suppress(FileNotFoundError):
            links.append(link.readlink().name)
    inodes = {name[len("socket:[") : -1] for name in links if name.startswith("socket:[")}
    found = []
    for protocol in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/{pid}/net/{protocol}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes:
                found.append((protocol, fields[1], fields[3]))
    return found
