"""How many may be connected at once, whatever they came for: open files are what the pad needs as well."""

from __future__ import annotations

import asyncio

from websockets.asyncio.server import ServerConnection


class Door:
    """Lets in so many connections and cuts off any beyond at once.

    kind: the connections to make, of which the door knows.
    """

    def __init__(self, limit: int) -> None:
        self._inside: set[ServerConnection] = set()
        inside = self._inside

        class Counted(ServerConnection):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                super().connection_made(transport)
                inside.add(self)
                if len(inside) > limit:
                    self.transport.abort()

            def connection_lost(self, exc: Exception | None) -> None:
                inside.discard(self)
                super().connection_lost(exc)

        self.kind: type[ServerConnection] = Counted

    def shut(self) -> None:
        """Cut off whoever is still inside."""
        for connection in list(self._inside):
            connection.transport.abort()
