"""The viewers of the live page; a slow one does not hold up the others."""

from collections.abc import Callable

from websockets.asyncio.server import ServerConnection, broadcast

MOST_VIEWERS = 16
# Backlog per viewer besides the kernel's buffer, about half a second of frames. A viewer that is further
# behind skips frames until there is room again.
MOST_WAITING_BYTES = 4096


class Viewers:
    """Sends to all viewers; one that is too slow misses frames and then gets the whole state.

    state: returns the whole state, one JSON text for each pad. Use in the event loop's thread only.
    """

    def __init__(self, state: Callable[[], list[str]]) -> None:
        self._state = state
        self._all: set[ServerConnection] = set()
        self._behind: set[ServerConnection] = set()
        # Viewers that are still receiving the state, and its length.
        self._getting_state: set[ServerConnection] = set()
        self._state_bytes = 0

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
        self._getting_state.discard(viewer)

    def tell(self, message: str) -> None:
        """Send a message that no viewer may miss; the state must already contain it."""
        # Events wait behind a long state; otherwise a viewer on a slow line would get state after state.
        waiting = {viewer for viewer in self._getting_state if _has_room(viewer, self._state_bytes)}
        self._behind.update(viewer for viewer in self._all - waiting if not _has_room(viewer))
        broadcast(self._all - self._behind, message)
        self._catch_up()

    def show(self, message: str | bytes) -> None:
        """Send a message that a slow viewer may miss."""
        self._catch_up()
        broadcast([viewer for viewer in self._all - self._behind if _has_room(viewer)], message)

    def _catch_up(self) -> None:
        """Send the state to viewers that had fallen behind and have room again."""
        self._getting_state = {viewer for viewer in self._getting_state if not _has_room(viewer)}
        ready = [viewer for viewer in self._behind if _has_room(viewer)]
        if ready:
            self._behind.difference_update(ready)
            self._getting_state.update(ready)
            states = self._state()
            self._state_bytes = sum(map(len, states))
            for state in states:
                broadcast(ready, state)


def _has_room(viewer: ServerConnection, beside_bytes: int = 0) -> bool:
    return viewer.transport.get_write_buffer_size() <= MOST_WAITING_BYTES + beside_bytes
