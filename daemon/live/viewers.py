"""Everyone who looks at the live page: each gets what there is room for, and none waits for another."""

from __future__ import annotations

from collections.abc import Callable

from websockets.asyncio.server import ServerConnection, broadcast

MOST_VIEWERS = 16
# What may wait for a slow viewer, besides what the kernel holds: about half a second of frames. One who is
# behind by more gets the newest once there is room again, not what was missed.
MOST_WAITING_BYTES = 4096


class Viewers:
    """Sends to all who look; a viewer who is too slow misses frames, and is told the state anew.

    state: returns all that a viewer must know, as JSON a pad. To be used in the event loop's thread only.
    """

    def __init__(self, state: Callable[[], list[str]]) -> None:
        self._state = state
        self._all: set[ServerConnection] = set()
        self._behind: set[ServerConnection] = set()

    def __len__(self) -> int:
        return len(self._all)

    def add(self, viewer: ServerConnection) -> bool:
        """Send to this one too, from the state on; False when there are too many already."""
        if len(self._all) >= MOST_VIEWERS:
            return False
        self._all.add(viewer)
        self._behind.add(viewer)
        self._catch_up()
        return True

    def discard(self, viewer: ServerConnection) -> None:
        """Send nothing more to this one."""
        self._all.discard(viewer)
        self._behind.discard(viewer)

    def tell(self, message: str) -> None:
        """Send what nobody may miss; the message counts as part of the state from now on."""
        self._behind.update(viewer for viewer in self._all if not _has_room(viewer))
        broadcast(self._all - self._behind, message)
        self._catch_up()

    def show(self, message: str | bytes) -> None:
        """Send what whoever is too slow for it may miss."""
        self._catch_up()
        broadcast([viewer for viewer in self._all - self._behind if _has_room(viewer)], message)

    def _catch_up(self) -> None:
        """Send the state to those who are behind and have room again."""
        ready = [viewer for viewer in self._behind if _has_room(viewer)]
        if ready:
            self._behind.difference_update(ready)
            for state in self._state():
                broadcast(ready, state)


def _has_room(viewer: ServerConnection) -> bool:
    return viewer.transport.get_write_buffer_size() <= MOST_WAITING_BYTES
