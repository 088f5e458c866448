"""Limits on connections: they share the daemon's memory and descriptors."""

import asyncio

from websockets.asyncio.server import ServerConnection
from websockets.protocol import State

# What may wait for a viewer that keeps sending: every ping is answered, whether or not the answers are read.
MOST_UNREAD_BYTES = 1_000_000


class Door:
    """Closes connections beyond the limit, and any that sends but does not read.

    Beyond the limit, the connection that has waited longest without finishing its request is closed, so that
    half-open connections cannot lock others out; if there is none, the new connection is closed.

    limit: number of connections. kind: the connections' class, for `serve`.
    """

    def __init__(self, limit: int) -> None:
        # In the order of their arrival.
        self._inside: dict[ServerConnection, None] = {}
        inside = self._inside

        class Counted(ServerConnection):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                super().connection_made(transport)
                inside[self] = None
                if len(inside) > limit:
                    half_open = (one for one in inside if one.state is State.CONNECTING)
                    next(half_open, self).transport.abort()

            def data_received(self, data: bytes) -> None:
                if self.transport.get_write_buffer_size() > MOST_UNREAD_BYTES:
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
