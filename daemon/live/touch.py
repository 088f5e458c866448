"""Messages from viewers of a page that can be touched: where their pointers press the pad.

Only `touchd demo` and `touchd fake-pad` serve such a page. Messages are bounded in size, number and values.
"""

import math
import threading
import time
from collections.abc import Hashable
from typing import Annotated, NamedTuple

import msgspec

from touchd.drivers.fakes.pointers import Pointer, Size
from touchd.drivers.frame import COLUMNS, ROWS

MOST_POINTERS = 10
# A page sends at most one message for each picture that it draws.
MESSAGES_PER_S = 90.0
# A page sends at least ten messages a second while it presses; after this long without one, it has let go.
LIFTED_AFTER_S = 1.5

Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
PointerId = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]


class _Spot(NamedTuple):
    """A pointer on the page. x, y: shares of the pad's width and height. pressure: None if not measured."""

    pointer: PointerId
    x: Share
    y: Share
    pressure: Share | None


class _Touch(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that presses on one page now."""

    size: Size
    at: Annotated[list[_Spot], msgspec.Meta(max_length=MOST_POINTERS)]


_decode = msgspec.json.Decoder(_Touch).decode


class Touching:
    """The pointers of all viewers. Thread-safe.

    near_s: when one was last at the pad, pressing or about to.
    """

    MOST_MESSAGE_BYTES = 512

    def __init__(self) -> None:
        self.near_s = -math.inf
        self._lock = threading.Lock()
        self._pressing: dict[Hashable, tuple[float, dict[Hashable, Pointer]]] = {}
        self._allowance: dict[Hashable, tuple[float, float]] = {}

    def take(self, viewer: Hashable, message: str | bytes) -> str:
        """Update a viewer's pointers from its message; returns why the message is refused, or ""."""
        now_s = time.monotonic()
        last_s, left = self._allowance.get(viewer, (now_s, MESSAGES_PER_S))
        left = min(MESSAGES_PER_S, left + (now_s - last_s) * MESSAGES_PER_S) - 1.0
        if left < 0.0:
            return "too many messages"
        self._allowance[viewer] = now_s, left
        try:
            touch = _decode(message)
        except (msgspec.DecodeError, UnicodeDecodeError):
            return "not a touch"
        pressed: dict[Hashable, Pointer] = {
            (viewer, spot.pointer): Pointer(
                ROWS * spot.y - 0.5, COLUMNS * spot.x - 0.5, touch.size, spot.pressure
            )
            for spot in touch.at
        }
        with self._lock:
            self.near_s = now_s
            self._pressing[viewer] = now_s, pressed
        return ""

    def leave(self, viewer: Hashable) -> None:
        """Lift everything that a viewer presses."""
        with self._lock:
            self._pressing.pop(viewer, None)
        self._allowance.pop(viewer, None)

    def pointers(self) -> dict[Hashable, Pointer]:
        """Return the pointers that press now, by identity."""
        oldest_s = time.monotonic() - LIFTED_AFTER_S
        with self._lock:
            fresh = [pressed for at_s, pressed in self._pressing.values() if at_s >= oldest_s]
        return {key: pointer for pressed in fresh for key, pointer in pressed.items()}
