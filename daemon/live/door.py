"""Limits on connections and on what each may send: they share the daemon's memory and descriptors."""

import asyncio
import time

from websockets.asyncio.server import ServerConnection
from websockets.protocol import State

# A browser sends a request with its headers, then ten bytes every five seconds in answer to our pings.
FIRST_BYTES = 16 * 1024
BYTES_PER_S = 16.0


class Door:
    """Closes connections beyond the limit, and any that sends too much.

    Beyond the limit, the connection that has waited longest without finishing its request is closed, so that
    half-open connections cannot lock others out; if there is none, the new connection is closed.
    The server answers every ping and keeps every fragment, so limiting what a viewer sends limits its cost.

    limit: number of connections. bytes_per_s: what each may send. kind: the connections' class, for `serve`.
    """

    def __init__(self, limit: int, bytes_per_s: float = BYTES_PER_S) -> None:
        # In the order of their arrival.
        self._inside: dict[ServerConnection, None] = {}
        inside = self._inside

        class Counted(ServerConnection):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                super().connection_made(transport)
                self._begun_s = time.monotonic()
                self._received_bytes = 0
                inside[self] = None
                if len(inside) > limit:
                    half_open = (one for one in inside if one.state is State.CONNECTING)
                    next(half_open, self).transport.abort()

            def data_received(self, data: bytes) -> None:
                self._received_bytes += len(data)
                if self._received_bytes > FIRST_BYTES + bytes_per_s * (time.monotonic() - self._begun_s):
                    self.transport.abort()
                else:
                    super().data_received(data)

            def connection_lost(self, exc: Exception | None) -> None:
                inside.pop(self, None)
                super().connection_lost(exc)

        self.kind: type[ServerConnection] = Counted

    def shut(self) -> None:
        for connection in list(self._inside):
            connection.transport.abort()
