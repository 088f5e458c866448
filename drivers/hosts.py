"""Connects to hosts by name, for the robot, MQTT, rosbridge and pads; returns this computer's addresses.

The lookup of a name does not count for the time limit of the connection, and its addresses are cached while
they work: nao.local may take seconds to resolve if nobody answers the query for its IPv6 address.
"""

import errno
import fcntl
import ipaddress
import logging
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any, TypeAlias

from touchd.drivers.errors import reason

log = logging.getLogger(__name__)

# How long a caller waits for a lookup; the lookup continues, and the next attempt waits for it again.
LOOKUP_S = 20.0
SLOW_S = 1.0
# Time for one address to answer before the next is tried beside it (RFC 8305).
HEAD_START_S = 0.25
# Poll interval for the stop event.
SLICE_S = 0.05
# A name server may return any number of addresses.
MOST_ADDRESSES = 8
# ioctl(2), netdevice(7): the address of an interface.
SIOCGIFADDR = 0x8915

# Socket options. The last four detect within 10 s that a network drops everything or a peer reads nothing, on
# an idle connection as well as with unsent bytes, which must not arrive much later.
OPTIONS = (
    (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
    (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
    (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 4),
    (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 2),
    (socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3),
    (socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 10_000),
)

Address: TypeAlias = tuple[socket.AddressFamily, Any]


def connect(host: str, port: int, limit_s: float, stopping: threading.Event | None = None) -> socket.socket:
    """Return a connection to a host, with `limit_s` as its timeout; raises OSError.

    limit_s: for the connection alone, without the lookup of the name. stopping: ends every wait.
    """
    name, stopping = _name(host), stopping or threading.Event()
    try:
        return dial(name.addresses(port, stopping), limit_s, stopping)
    except OSError:
        name.look_up()
        raise


def dial(addresses: Iterable[Address], limit_s: float, stopping: threading.Event) -> socket.socket:
    """Return a connection to the address that answers first; raises OSError.

    Each address is tried a moment after the one before, or once that has failed.
    """
    waiting, trying, poller = list(addresses), dict[int, socket.socket](), select.poll()
    until_s, next_s = time.monotonic() + limit_s, 0.0
    failed: OSError = TimeoutError(f"no answer within {limit_s:g} s")
    try:
        while (waiting or trying) and (now_s := time.monotonic()) < until_s and not stopping.is_set():
            try:
                if waiting and (now_s >= next_s or not trying):
                    started = _start(*waiting.pop(0))
                    trying[started.fileno()], next_s = started, now_s + HEAD_START_S
                    poller.register(started, select.POLLOUT)
                for fd, _ in poller.poll(1000 * SLICE_S):
                    poller.unregister(fd)
                    answered = trying.pop(fd)
                    if code := answered.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                        answered.close()
                        raise OSError(code, os.strerror(code))
                    answered.settimeout(limit_s)
                    return answered
            except OSError as error:
                failed = error
        raise failed
    finally:
        for tried in trying.values():
            tried.close()


def _start(family: socket.AddressFamily, where: Any) -> socket.socket:
    started = socket.socket(family, socket.SOCK_STREAM)
    try:
        started.setblocking(False)
        for option in OPTIONS:
            started.setsockopt(*option)
        if (code := started.connect_ex(where)) not in (0, errno.EINPROGRESS):
            raise OSError(code, os.strerror(code))
    except OSError:
        started.close()
        raise
    return started


class Name:
    """A host's name and its last known addresses."""

    def __init__(self, host: str) -> None:
        self._host, self._lock, self._is_slow = host, threading.Lock(), False
        self._found: Sequence[Address] = ()
        self._failed: Exception | None = None
        self._lookup: threading.Thread | None = None

    def addresses(self, port: int, stopping: threading.Event) -> Sequence[Address]:
        """Return the addresses, looked up if none is known; raises OSError."""
        if not self._found:
            lookup = self.look_up()
            until_s = time.monotonic() + LOOKUP_S
            while lookup.is_alive() and time.monotonic() < until_s and not stopping.is_set():
                lookup.join(SLICE_S)
        found, failed = self._found, self._failed
        if not found:
            why = reason(failed) if failed else f"no address within {LOOKUP_S:g} s"
            raise socket.gaierror(socket.EAI_NONAME, f"{self._host} cannot be resolved: {why}")
        return [(family, (where[0], port, *where[2:])) for family, where in found]

    def look_up(self) -> threading.Thread:
        """Start a lookup, unless one is running; until it ends, the known addresses are used."""
        with self._lock:
            if self._lookup is None or not self._lookup.is_alive():
                self._lookup = threading.Thread(target=self._look_up, name="touchd-lookup", daemon=True)
                self._lookup.start()
            return self._lookup

    def _look_up(self) -> None:
        started_s = time.monotonic()
        try:
            # Bytes: for a text, Python loads a codec of 0.7 MB.
            host = self._host.encode() if self._host.isascii() else self._host
            answers = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
        except (OSError, ValueError) as error:
            self._failed, self._found = error, ()
            return
        found = dict.fromkeys((family, where) for family, _, _, _, where in answers)
        self._found = list(found)[:MOST_ADDRESSES]
        took_s = time.monotonic() - started_s
        if took_s > SLOW_S and not self._is_slow:
            self._is_slow = True
            number = min(self._found, key=lambda each: each[0])[1][0]
            advice = f"give its number instead, {number}"
            if self._host.endswith(".local"):
                advice += ", or put mdns4_minimal in the place of mdns_minimal in /etc/nsswitch.conf"
            log.warning("%s takes %.1f s to resolve: %s", self._host, took_s, advice)


_name = lru_cache(Name)


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
