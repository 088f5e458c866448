"""The base classes of bridges: a bounded queue, a limited frame rate, a connection that is kept open."""

import importlib
import logging
import threading
import time
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, TypeAlias

from touchd.daemon.path.events import Event
from touchd.daemon.sinks.sink import QueuedSink
from touchd.drivers.errors import TouchdError
from touchd.drivers.faults import Backoff
from touchd.drivers.frame import Frame

# Module and class of each section of the configuration.
BRIDGES = {
    "mqtt": "mqtt:MqttBridge",
    "lsl": "lsl:LslBridge",
    "ros2": "ros2:Ros2Bridge",
    "rosbridge": "rosbridge:RosbridgeBridge",
}
# An event, or a frame and its pad.
Item: TypeAlias = Event | tuple[Frame, str]

# One second of frames of a pad; more would only delay events.
MOST_FRAMES = 54
POLL_S = 0.05
# Kinds of fault: nothing answers, or the peer ended the connection.
OUT_OF_REACH, AWAY = "out of reach", "away"
BACKOFF_FIRST_S, BACKOFF_CAP_S = 0.1, 2.0
# After a connection that lasted this long, the pauses between attempts begin again with the shortest.
STEADY_S = 5.0
# An event is dropped once this many connections have ended while it was being sent.
TRIES = 3
GOODBYE_S = 1.0


class BridgeError(TouchdError):
    """A bridge cannot be used as configured; the message is one line that says what to do."""


def bridge_class(name: str) -> Any:
    """Import the bridge of a section; raises ImportError or RuntimeError if its library cannot be loaded."""
    module, _, kind = BRIDGES[name].partition(":")
    return getattr(importlib.import_module(f"touchd.daemon.bridges.{module}"), kind)


def kind_of(event: Event) -> str:
    """Return the `type` of an event's line."""
    return str(event.__struct_config__.tag)


class Bridge(QueuedSink[Item]):
    """Sends the events of one or several pads to another system, and their frames if configured.

    `open`, `write` and `close` run in the sink's own thread. While the peer is away, events are queued and
    frames are dropped; a full queue drops its oldest events. Other pads' events are ignored.
    frames_hz: at most this many frames a second for each pad; math.inf: all frames; None: none.
    refused: number of messages that the peer refused. opened: set once `open` has returned.
    """

    def __init__(self, name: str, pads: Sequence[str], frames_hz: float | None) -> None:
        self.pads = frozenset(pads)
        self.frames_hz = frames_hz
        self.refused = 0
        self.opened = threading.Event()
        self._next_frame_s = dict.fromkeys(pads, 0.0)
        self._peer_is_there = threading.Event()
        self._was_reported = False
        self._there_since_s = 0.0
        self._backoff = Backoff(BACKOFF_FIRST_S, BACKOFF_CAP_S)
        super().__init__(name, logging.getLogger(f"touchd.daemon.bridges.{name}"))

    def put(self, item: Item) -> None:
        """Queue an event of these pads or of the robot; never blocks."""
        if isinstance(item, tuple) or getattr(item, "pad", None) in {None, *self.pads}:
            super().put(item)

    def put_frame(self, frame: Frame, pad: str) -> None:
        """Queue a frame if one is due and the peer is connected; never blocks."""
        if self.frames_hz is None or pad not in self.pads or not self._peer_is_there.is_set():
            return
        due_s, period_s = self._next_frame_s[pad], 1.0 / self.frames_hz
        if frame.host_s < due_s:
            return
        # A late frame does not shift the schedule; after a pause, the schedule restarts.
        is_late = frame.host_s - due_s < period_s
        self._next_frame_s[pad] = (due_s if is_late else frame.host_s) + period_s
        if len(self._items) < MOST_FRAMES * len(self.pads):
            self.put((frame, pad))
        else:
            self._items.dropped += 1

    @abstractmethod
    def open(self) -> None:
        """Create the library's objects; must not wait for the peer."""

    @abstractmethod
    def close(self) -> None:
        """Disconnect and free what `open` created."""

    def _run(self) -> None:
        try:
            self.open()
            self.opened.set()
            super()._run()
            self.close()
        except Exception:
            self._log.exception("%s has failed; the daemon goes on without it", self.name)
        if self.refused > 1:
            self._log.warning("%s: %d messages were refused in all", self.name, self.refused)

    def _note_there(self, where: str) -> None:
        """Note that the peer is connected."""
        self._there_since_s = time.monotonic()
        self._peer_is_there.set()
        if not self._was_reported:
            self._log.info("%s: connected to %s", self.name, where)
        self._was_reported = True
        # A peer that was away and then out of reach has come back once.
        is_said = self._faults.end(AWAY, f"connected to {where}")
        self._faults.end(OUT_OF_REACH, "" if is_said else f"connected to {where}")

    def _note_away(self, where: str, reason: str, kind: str = AWAY) -> None:
        """Note why the peer is away; called after each attempt to reach it."""
        if self._peer_is_there.is_set() and time.monotonic() - self._there_since_s >= STEADY_S:
            self._backoff.reset()
        self._peer_is_there.clear()
        self._was_reported = True
        if kind == AWAY:
            self._faults.end(OUT_OF_REACH, f"{where} answers")
        self._faults.begin(kind, f"{where} is away ({reason}); trying until it is there")

    def _note_refused(self, why: str) -> None:
        """Count a message that the peer refused, and log why."""
        self.refused += 1
        self._faults.begin("refused", f"the peer refused something ({why})", cause=why)


class ConnectedBridge(Bridge):
    """A bridge over a connection that its own thread keeps open.

    where: the peer's address, for the log.
    """

    def __init__(self, name: str, pads: Sequence[str], frames_hz: float | None, where: str) -> None:
        self._where = where
        self._connection_number = 0
        self._ending = threading.Event()
        self._keeper = threading.Thread(target=self._keep_connected, name=f"touchd-{name}-link", daemon=True)
        super().__init__(name, pads, frames_hz)

    @abstractmethod
    def hold(self) -> str:
        """Connect, call `connected`, and return why the connection ended; runs in the keeper's thread.

        If it raises an error, that is logged as the reason.
        """

    @abstractmethod
    def send_event(self, event: Event) -> bool:
        """Send an event; return False if the connection ended before the peer had the event."""

    @abstractmethod
    def send_frame(self, frame: Frame, pad: str) -> None:
        """Send a frame, or drop it."""

    @abstractmethod
    def hang_up(self) -> None:
        """End the current connection, if any, so that `hold` returns soon."""

    def open(self) -> None:
        self._keeper.start()

    def write(self, item: Item) -> None:
        """Send one item. An event is sent again over the next connection if this one is lost."""
        if isinstance(item, tuple):
            self.send_frame(*item)
            return
        tried = 0
        for _ in range(TRIES):
            tried = self._await_connection(tried)
            if not tried or self.send_event(item):
                return
        self._note_refused(f"{kind_of(item)}: {TRIES} connections ended while it was sent")

    def close(self) -> None:
        self._ending.set()
        self.hang_up()
        self._keeper.join(GOODBYE_S)

    def connected(self) -> None:
        """Note that the peer is connected, so that events can be sent."""
        self._connection_number += 1
        self._note_there(self._where)

    def _await_connection(self, after: int) -> int:
        """Wait for a connection other than number `after`; return its number, 0 if the sink is stopping."""
        while not self._abandoned.is_set():
            if self._peer_is_there.wait(POLL_S) and self._connection_number != after:
                return self._connection_number
            if self._peer_is_there.is_set():
                self._abandoned.wait(POLL_S)
        return 0

    def _keep_connected(self) -> None:
        while not self._ending.is_set():
            kind = AWAY
            try:
                reason = self.hold()
            except OSError as error:
                kind, reason = OUT_OF_REACH, f"cannot be reached: {error.strerror or error}"
            # A peer's bytes can make libraries raise undocumented errors.
            except Exception as error:
                reason = f"{type(error).__name__}: {error}"
            if self._ending.is_set():
                return
            self._note_away(self._where, reason, kind)
            self._ending.wait(self._backoff.pause_s())


class Allowance:
    """Limits a peer's bytes: `first` at once, `per_s` a second, and `for_each` for each message sent to it.

    touchd subscribes to little or nothing, so a peer need not send much. Libraries keep or parse whatever it
    sends, so its bytes are limited before a library sees them.
    """

    def __init__(self, first: int, for_each: int, per_s: float = 16.0) -> None:
        self._left = float(first)
        self._for_each = for_each
        self._per_s = per_s
        self._counted_s = time.monotonic()
        self.is_spent = False

    def sent(self, echoed: int = 0) -> None:
        """Note that a message was sent to the peer. echoed: bytes of it that the peer sends back."""
        self._left += self._for_each + echoed

    def take(self, count: int) -> bool:
        """Count received bytes; returns whether they were allowed."""
        now_s = time.monotonic()
        self._left += self._per_s * (now_s - self._counted_s) - count
        self._counted_s = now_s
        self.is_spent |= self._left < 0
        return not self.is_spent


def arrival_s(frame: Frame) -> float:
    """Return when a frame's last byte arrived, in seconds since 1970."""
    return time.time() - (time.monotonic() - frame.host_s)
