"""How many may be connected at once, and how much each may say: files and memory are the daemon's as well."""

from __future__ import annotations

import asyncio
import time

from websockets.asyncio.server import ServerConnection

# What a browser sends: a request with its headers, then ten bytes in five seconds in answer to our pings.
FIRST_BYTES = 16 * 1024
BYTES_PER_S = 16.0


class Door:
    """Lets in so many connections and cuts off any beyond at once, and each that says too much.

    Each ping is answered, and each fragment of a message kept: what a viewer may send bounds what it costs,
    whatever it sends and whether it reads or not.

    kind: the connections to make, of which the door knows.
    """

    def __init__(self, limit: int) -> None:
        self._inside: set[ServerConnection] = set()
        inside = self._inside

        class Counted(ServerConnection):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                super().connection_made(transport)
                self._begun_s = time.monotonic()
                self._heard_bytes = 0
                inside.add(self)
                if len(inside) > limit:
                    self.transport.abort()

            def data_received(self, data: bytes) -> None:
                self._heard_bytes += len(data)
                if self._heard_bytes > FIRST_BYTES + BYTES_PER_S * (time.monotonic() - self._begun_s):
                    self.transport.abort()
                else:
                    super().data_received(data)

            def connection_lost(self, exc: Exception | None) -> None:
                inside.discard(self)
                super().connection_lost(exc)

        self.kind: type[ServerConnection] = Counted

    def shut(self) -> None:
        """Cut off whoever is still inside."""
        for connection in list(self._inside):
            connection.transport.abort()
