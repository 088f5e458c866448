"""A pad on the network: over TCP touchd connects to it, over UDP it listens for what the pad sends."""

import errno
import re
import select
import socket

from touchd.drivers import hosts

ADDRESS = re.compile(r"(tcp|udp)://(\[[^\s\]]+\]|[^\s/:?]+)(?::(\d{0,5}))?")
CONNECT_S = 3.0
MAX_BYTES = 65536


def address_of(port: str) -> tuple[str, str, int]:
    """Return "tcp" or "udp", host and number of a pad's address on the network; raises ValueError."""
    match = ADDRESS.fullmatch(port.strip())
    if match is not None and not match[3]:
        raise ValueError(f"lacks its port; write it as in {port.strip().rstrip(':')}:4000")
    if match is None or int(match[3]) > 65535:
        raise ValueError("not an address such as tcp://192.168.1.20:4000 or udp://0.0.0.0:4000")
    return match[1], match[2].strip("[]"), int(match[3])


class NetworkPort:
    """tcp://host:port connects to the pad; udp://address:port listens there for what the pad sends."""

    def __init__(self, port: str, protocol: str, host: str, number: int, timeout_s: float) -> None:
        self.port = port
        self.baudrate = 0
        self.is_stream = protocol == "tcp"
        if self.is_stream:
            self._socket = hosts.connect(host, number, CONNECT_S)
        else:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            try:
                self._socket.bind((host, number))
            except OSError:
                self._socket.close()
                raise
        self._socket.settimeout(timeout_s)

    def read(self, *, is_text: bool) -> bytes:
        """Return what has arrived, waiting for it at most the timeout; over UDP, one datagram.

        is_text: whether the pad sends lines, which end with their datagram.
        """
        try:
            data = self._socket.recv(MAX_BYTES)
        except TimeoutError:
            return b""
        if self.is_stream and not data:
            raise ConnectionResetError(errno.ECONNRESET, "closed")
        return _ended_lines(data) if is_text and not self.is_stream else data

    def reset_input_buffer(self) -> None:
        while select.select([self._socket], [], [], 0)[0] and self._socket.recv(MAX_BYTES):
            pass

    def __enter__(self) -> "NetworkPort":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()


def _ended_lines(datagram: bytes) -> bytes:
    """Return a datagram of text with its last line ended, and with a blank line after several lines."""
    if not datagram.strip():
        return b""
    lines = datagram.rstrip(b"\r\n")
    return lines + (b"\n\n" if b"\n" in lines or b"\r" in lines else b"\n")
