"""The viewers of the live page and their limits: they share the daemon's memory and descriptors."""

import asyncio
from collections.abc import Callable
from typing import Any

from websockets.asyncio.server import ServerConnection, broadcast
from websockets.protocol import State

# Connections of any kind, including those for files and idle ones.
MOST_CONNECTIONS = 64
MOST_VIEWERS = 16
# Backlog from which on a viewer gets no frames, besides the kernel's buffer: about half a second of them.
MOST_WAITING_FRAMES = 4096
# Backlog at which a viewer is disconnected; its page connects again and gets the state. Sixteen pads' states
# have some 800 kB.
MOST_WAITING_BYTES = 1_000_000


class Connection(ServerConnection):
    """A connection that is closed if there are too many, and if it sends but does not read.

    Of too many, the one that has waited longest without finishing its request is closed, so that half-open
    connections cannot lock others out; if there is none, the new one. together: all, in order of arrival.
    """

    def __init__(self, together: dict["Connection", None], *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._together = together

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._together[self] = None
        if len(self._together) > MOST_CONNECTIONS:
            half_open = (one for one in self._together if one.state is State.CONNECTING)
            next(half_open, self).transport.abort()

    def data_received(self, data: bytes) -> None:
        # Every ping is answered, whether or not the answers are read.
        if _waiting_bytes(self) > MOST_WAITING_BYTES:
            self.transport.abort()
        else:
            super().data_received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._together.pop(self, None)
        super().connection_lost(exc)


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
