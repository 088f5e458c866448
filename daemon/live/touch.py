"""The page of `touchd demo` and `touchd fake-pad`, on which viewers touch a simulated pad."""

import json
import math
import re
import threading
import time
from collections.abc import Hashable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from touchd.daemon.app.config import Settings
from touchd.daemon.live.server import LiveServer
from touchd.daemon.path.events import LivePrediction
from touchd.drivers.fakes.pointers import Pointer, Size
from touchd.drivers.frame import COLUMNS, DEFAULT_PAD, ROWS
from touchd.model.classifier import Classifier

MOST_POINTERS = 10
# A page sends at least ten messages a second while it presses; after this long without one, it has let go.
LIFTED_AFTER_S = 1.5
RETRY_S = 0.2
# The line that a daemon with a page logs.
SERVED = re.compile(r"live page: http://(\S+)/")

Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
PointerId = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]


class _Spot(NamedTuple):
    """A pointer on the page. x, y: shares of the pad's width and height. pressure: None if not measured."""

    pointer: PointerId
    x: Share
    y: Share
    pressure: Share | None


class _Touch(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All pointers that press on one page now."""

    size: Size
    at: Annotated[list[_Spot], msgspec.Meta(max_length=MOST_POINTERS)]


class Touching:
    """The pointers of all viewers, from messages that are bounded in size and values. Thread-safe.

    near_s: when a pointer was last at the pad, pressing or about to.
    """

    def __init__(self) -> None:
        self.near_s = -math.inf
        self._lock = threading.Lock()
        self._pressing: dict[Hashable, tuple[float, dict[Hashable, Pointer]]] = {}

    def take(self, viewer: Hashable, message: str | bytes) -> str:
        """Update a viewer's pointers from its message; returns why the message is refused, or ""."""
        now_s = time.monotonic()
        try:
            touch = msgspec.json.decode(message, type=_Touch)
        except (msgspec.DecodeError, UnicodeDecodeError):
            return "not a touch"
        pressed: dict[Hashable, Pointer] = {
            (viewer, pointer): Pointer(ROWS * y - 0.5, COLUMNS * x - 0.5, touch.size, pressure)
            for pointer, x, y, pressure in touch.at
        }
        with self._lock:
            self.near_s = now_s
            self._pressing[viewer] = now_s, pressed
        return ""

    def pointers(self) -> dict[Hashable, Pointer]:
        """Return the pointers that press now, by identity; those of a viewer who left lift."""
        oldest_s = time.monotonic() - LIFTED_AFTER_S
        with self._lock:
            fresh = {viewer: one for viewer, one in self._pressing.items() if one[0] >= oldest_s}
            self._pressing = fresh
        return {key: pointer for _, pressed in fresh.values() for key, pointer in pressed.items()}


class TouchPage(LiveServer):
    """The page of a simulated pad, served by this process; without a model it shows the pad alone."""

    def __init__(self, settings: Settings, model: Classifier | None) -> None:
        self.touching = Touching()
        super().__init__(settings, {DEFAULT_PAD: model}, self.touching.take)

    def follow(self, log: Path) -> None:
        """Show the live predictions of a daemon with its own page, whose address is in its log."""
        threading.Thread(target=self._relay, args=(log,), name="touchd-relay", daemon=True).start()

    def _relay(self, log: Path) -> None:
        while not self._is_stopping:
            time.sleep(RETRY_S)
            with suppress(OSError, WebSocketException):
                served = SERVED.search(log.read_text(errors="replace"))
                if served is None:
                    continue
                with connect(f"ws://{served[1]}/stream", compression=None) as viewer:
                    for message in viewer:
                        if isinstance(message, str) and json.loads(message)["type"] == "live_prediction":
                            self.put(msgspec.json.decode(message, type=LivePrediction))
