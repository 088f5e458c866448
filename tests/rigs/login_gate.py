"""The login of NAOqi 2.9: TLS, a user and a token in front of a plain qi server.

Python's qi can be a client of such a robot but not the server, so this does the server's part: it terminates
TLS, checks the login in the first message, and then passes bytes through.
"""

import asyncio
import ssl
import threading
from contextlib import suppress
from typing import NamedTuple

import trustme

from touchd.drivers.robot.values import read, write
from touchd.drivers.robot.wire import ERROR, HEADER


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
            magic, number, size, version, _, *target = HEADER.unpack(header)
            payload = await reader.readexactly(size)
            first = header + payload
            self.first_messages.append(first)
            given = read("{sm}", payload)
            if (given.get("auth_user"), given.get("auth_token")) == self.login:
                inner_reader, inner_writer = await asyncio.open_connection("127.0.0.1", self._inner_port)
                inner_writer.write(first)
                await asyncio.gather(_pump(reader, inner_writer), _pump(inner_reader, writer))
            else:
                why = write("m", "Authentication failed: wrong user or token")
                writer.write(HEADER.pack(magic, number, len(why), version, ERROR, *target) + why)
                await writer.drain()
        writer.close()


async def _pump(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await source.read(65536):
            sink.write(data)
            await sink.drain()
    sink.close()
