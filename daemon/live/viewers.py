"""The viewers of the live page and their limits: they share the daemon's memory and descriptors."""

import asyncio
from collections.abc import Callable

from websockets.asyncio.server import ServerConnection, broadcast
from websockets.protocol import State

MOST_VIEWERS = 16
# Backlog from which on a viewer gets no frames, besides the kernel's buffer: about half a second of them.
MOST_WAITING_FRAMES = 4096
# Backlog at which a viewer is disconnected; its page connects again and gets the state. Sixteen pads' states
# have some 800 kB.
MOST_WAITING_BYTES = 1_000_000


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
                # Every ping is answered, whether or not the answers are read.
                if _waiting_bytes(self) > MOST_WAITING_BYTES:
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
    """Sends to all viewers; a slow one misses frames, one far behind is disconnected.

    state: returns the whole state, one JSON text for each pad. Use in the event loop's thread only.
    """

    def __init__(self, state: Callable[[], list[str]]) -> None:
        self._state = state
        self._all: set[ServerConnection] = set()

    def __len__(self) -> int:
        return len(self._all)

    def add(self, viewer: ServerConnection) -> bool:
        """Add a viewer and send it the state; False when there are too many."""
        if len(self._all) >= MOST_VIEWERS:
            return False
        self._all.add(viewer)
        for state in self._state():
            broadcast([viewer], state)
        return True

    def discard(self, viewer: ServerConnection) -> None:
        self._all.discard(viewer)

    def tell(self, message: str) -> None:
        """Send a message that no viewer may miss."""
        for viewer in [one for one in self._all if _waiting_bytes(one) > MOST_WAITING_BYTES]:
            viewer.transport.abort()
            self.discard(viewer)
        broadcast(self._all, message)

    def show(self, message: str | bytes) -> None:
        """Send a message that a slow viewer may miss."""
        broadcast((one for one in self._all if _waiting_bytes(one) <= MOST_WAITING_FRAMES), message)


def _waiting_bytes(viewer: ServerConnection) -> int:
    return viewer.transport.get_write_buffer_size()
