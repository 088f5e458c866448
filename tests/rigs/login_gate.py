"""The login of NAOqi 2.9: TLS, a user and a token in front of a plain qi server.

Python's qi can be a client of such a robot but not the server, so this does the server's part: it terminates
TLS, checks the login in the first message, and then passes bytes through.
"""

import logging
import socket
import ssl
import struct
import threading
from contextlib import suppress
from typing import NamedTuple

import trustme

log = logging.getLogger(__name__)

# libqi, messaging/message.hpp: magic, id, bytes that follow, version, type, flags, service, object, action.
HEADER = struct.Struct("<IIIHBBIII")
MAGIC = 0x42ADDE42
TYPE_ERROR = 3
MAX_FIRST_MESSAGE_BYTES = 64 * 1024


class Login(NamedTuple):
    """What a client must send."""

    user: str
    token: str


class Gate:
    """Lets clients with the right login through to a server on this machine.

    port: where to listen on 127.0.0.1. inner_port: the server's. authority: signs the certificate.
    first_messages: of each client.
    """

    def __init__(self, port: int, inner_port: int, login: Login, authority: trustme.CA) -> None:
        self._inner_port = inner_port
        self.login = login
        self.first_messages: list[bytes] = []
        self._tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        authority.issue_cert("nao").configure_cert(self._tls)
        self._listener = socket.create_server(("127.0.0.1", port))
        self._accepting = threading.Thread(target=self._accept, name="login-gate", daemon=True)
        self._accepting.start()

    def close(self) -> None:
        # While a thread waits in accept, closing alone leaves the port taken.
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._accepting.join(5.0)
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                threading.Thread(target=self._serve, args=(client,), name="login-gate", daemon=True).start()

    def _serve(self, plain: socket.socket) -> None:
        try:
            plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with self._tls.wrap_socket(plain, server_side=True) as client:
                first = _first_message(client)
                self.first_messages.append(first)
                if not _holds(first, self.login):
                    client.sendall(_refusal(first))
                    return
                with socket.create_connection(("127.0.0.1", self._inner_port)) as server:
                    server.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    server.sendall(first)
                    threading.Thread(target=_pump, args=(server, client), daemon=True).start()
                    _pump(client, server)
        except (OSError, ValueError) as error:
            log.debug("a client was not let in, or left: %s", error)


def _first_message(client: socket.socket) -> bytes:
    header = _read(client, HEADER.size)
    magic, _, size, *_ = HEADER.unpack(header)
    if magic != MAGIC or size > MAX_FIRST_MESSAGE_BYTES:
        raise ValueError("not a qi message")
    return header + _read(client, size)


def _read(client: socket.socket, size: int) -> bytes:
    parts = b""
    while len(parts) < size:
        part = client.recv(size - len(parts))
        if not part:
            raise ValueError("the client left")
        parts += part
    return parts


def _text(text: str) -> bytes:
    """Return a string as qi writes it: its length as uint32, then UTF-8."""
    encoded = text.encode()
    return struct.pack("<I", len(encoded)) + encoded


def _holds(message: bytes, login: Login) -> bool:
    """Return whether the map of capabilities in a message has this login: strings, or as qi nests them."""
    return all(
        any(_text(key) + nested + _text("s") + _text(value) in message for nested in (b"", _text("m")))
        for key, value in (("auth_user", login.user), ("auth_token", login.token))
    )


def _refusal(message: bytes) -> bytes:
    magic, number, _, version, _, flags, service, of, action = HEADER.unpack(message[: HEADER.size])
    reason = _text("s") + _text("Authentication failed: wrong user or token")
    return HEADER.pack(magic, number, len(reason), version, TYPE_ERROR, flags, service, of, action) + reason


def _pump(source: socket.socket, sink: socket.socket) -> None:
    with suppress(OSError, ValueError):
        while data := source.recv(65536):
            sink.sendall(data)
    for end in (source, sink):
        with suppress(OSError, ValueError):
            end.shutdown(socket.SHUT_RDWR)
