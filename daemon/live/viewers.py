"""The viewers of the live page and their limits: they share the daemon's memory and descriptors."""

import asyncio
from collections.abc import Callable

from websockets.asyncio.server import ServerConnection, broadcast
from websockets.protocol import State

MOST_VIEWERS = 16
# Backlog of frames for each viewer besides the kernel's buffer, about half a second of them.
MOST_WAITING_FRAMES = 4096
# Backlog of a viewer from which on it gets the whole state instead of events. A pad's state has some 50 kB.
MOST_WAITING_BYTES = 256 * 1024
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
                if _waiting_bytes(self) > MOST_UNREAD_BYTES:
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


class Viewers:
    """Sends to all viewers; a slow one misses frames, one far behind gets the whole state later.

    state: returns the whole state, one JSON text for each pad. Use in the event loop's thread only.
    """

    def __init__(self, state: Callable[[], list[str]]) -> None:
        self._state = state
        self._all: set[ServerConnection] = set()
        self._behind: set[ServerConnection] = set()

    def __len__(self) -> int:
        return len(self._all)

    def add(self, viewer: ServerConnection) -> bool:
        """Add a viewer and send it the state; False when there are too many."""
        if len(self._all) >= MOST_VIEWERS:
            return False
        self._all.add(viewer)
        self._behind.add(viewer)
        self._catch_up()
        return True

    def discard(self, viewer: ServerConnection) -> None:
        self._all.discard(viewer)
        self._behind.discard(viewer)

    def tell(self, message: str) -> None:
        """Send a message that no viewer may miss; the state must already contain it."""
        self._behind.update(viewer for viewer in self._all if _waiting_bytes(viewer) > MOST_WAITING_BYTES)
        broadcast(self._all - self._behind, message)
        self._catch_up()

    def show(self, message: str | bytes) -> None:
        """Send a message that a slow viewer may miss."""
        self._catch_up()
        broadcast(_with_room(self._all - self._behind), message)

    def _catch_up(self) -> None:
        """Send the state to viewers that had fallen behind and have room again."""
        if ready := _with_room(self._behind):
            self._behind -= ready
            for state in self._state():
                broadcast(ready, state)


def _waiting_bytes(viewer: ServerConnection) -> int:
    return viewer.transport.get_write_buffer_size()


def _with_room(viewers: set[ServerConnection]) -> set[ServerConnection]:
    return {viewer for viewer in viewers if _waiting_bytes(viewer) <= MOST_WAITING_FRAMES}
