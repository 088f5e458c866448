"""The login of NAOqi 2.9: TLS, a user and a token in front of a plain qi server.

Python's qi can be a client of such a robot but not the server, so this does the server's part: it terminates
TLS, checks the login in the first message, and then passes bytes through.
"""

import asyncio
import ssl
import struct
import threading
from contextlib import suppress
from typing import NamedTuple

import trustme

# libqi, messaging/message.hpp: magic, id, bytes that follow, version, type, flags, service, object, action.
HEADER = struct.Struct("<IIIHBBIII")
TYPE_ERROR = 3


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
        tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        authority.issue_cert("nao").configure_cert(tls)
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, name="login-gate", daemon=True).start()
        serving = asyncio.start_server(self._serve, "127.0.0.1", port, ssl=tls)
        self._server = asyncio.run_coroutine_threadsafe(serving, self._loop).result(5.0)

    def close(self) -> None:
        """Let nobody in any more."""

        async def close() -> None:
            self._server.close()

        asyncio.run_coroutine_threadsafe(close(), self._loop).result(5.0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError, asyncio.IncompleteReadError):
            header = await reader.readexactly(HEADER.size)
            first = header + await reader.readexactly(HEADER.unpack(header)[2])
            self.first_messages.append(first)
            if _holds(first, self.login):
                inner_reader, inner_writer = await asyncio.open_connection("127.0.0.1", self._inner_port)
                inner_writer.write(first)
                await asyncio.gather(_pump(reader, inner_writer), _pump(inner_reader, writer))
            else:
                writer.write(_refusal(first))
                await writer.drain()
        writer.close()


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


async def _pump(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await source.read(65536):
            sink.write(data)
            await sink.drain()
    sink.close()
