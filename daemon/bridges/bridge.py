"""The base class of bridges: a bounded queue, a limited frame rate, a connection that is kept open."""

import logging
import threading
import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

from touchd.daemon.path.events import Event
from touchd.daemon.sinks.sink import QueuedSink
from touchd.drivers.errors import TouchdError
from touchd.drivers.frame import COLUMNS, ROWS, Frame

# An event, or a frame and its pad.
Item: TypeAlias = Event | tuple[Frame, str]

# One second of frames of a pad; more would only delay events.
MOST_FRAMES = 54
POLL_S = 0.05
# A frame as a sensor_msgs/Image of ROS, without header and pixels.
IMAGE: Mapping[str, Any] = {
    "height": ROWS,
    "width": COLUMNS,
    "encoding": "mono16",
    "is_bigendian": 0,
    "step": 2 * COLUMNS,
}
# An event that has waited longer is not sent, here and to the robot: a receiver would take it for a new one.
STALE_S = 2.0
GOODBYE_S = 1.0
# How much a peer may send over a connection: at first, per second, and per item that it receives. touchd
# subscribes to next to nothing, but libraries keep whatever arrives.
PEER_FIRST_BYTES, PEER_BYTES_PER_S, PEER_BYTES_PER_ITEM = 16 * 1024, 64, 1024


class BridgeError(TouchdError):
    """A bridge cannot be used as configured; the message is one line that says what to do."""


def kind_of(event: Event) -> str:
    """Return the `type` of an event's line."""
    return str(event.__struct_config__.tag)


class Bridge(QueuedSink[Any]):
    """Sends the events of one or several pads to another system, and their frames if configured.

    One thread empties the queue, another keeps the connection open. While the peer is away, events wait for
    STALE_S and frames are dropped. Other pads' events are ignored.
    frames_hz: at most this many frames a second for each pad; math.inf: all frames; None: none.
    where: the peer's address, for the log.
    limit: of what the peer may send over the current connection.
    """

    # Pause before each attempt to connect again.
    retry_s = 1.0

    def __init__(self, name: str, pads: Sequence[str], frames_hz: float | None, where: str) -> None:
        self.frames_hz = frames_hz
        self.limit = PeerLimit()
        self._where = where
        self._next_frame_s = dict.fromkeys(pads, 0.0)
        self._peer_is_there, self._was_there = threading.Event(), False
        self._ending = threading.Event()
        self._keeper = threading.Thread(target=self._keep_connected, name=f"touchd-{name}-link", daemon=True)
        super().__init__(name, logging.getLogger(f"touchd.daemon.bridges.{name}"))

    @abstractmethod
    def hold(self) -> str:
        """Connect, call `connected`, serve, and return why the connection ended.

        Runs in the connection's thread. An error that it raises is logged as the reason.
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

    def note(self, event: Event) -> None:
        """Update the state that an event changes, even if the event is not sent."""

    def start(self) -> None:
        self._keeper.start()
        super().start()

    def put(self, item: Item) -> None:
        """Queue an event of these pads or of the robot; never blocks."""
        if isinstance(item, tuple) or getattr(item, "pad", None) in {None, *self._next_frame_s}:
            super().put((item, time.monotonic()))

    def put_frame(self, frame: Frame, pad: str) -> None:
        """Queue a frame if one is due and the peer is connected; never blocks."""
        if self.frames_hz is None or pad not in self._next_frame_s or not self._peer_is_there.is_set():
            return
        due_s, period_s = self._next_frame_s[pad], 1.0 / self.frames_hz
        if frame.host_s < due_s:
            return
        # A late frame keeps the schedule; after a pause, a new one begins.
        begin_s = due_s if frame.host_s - due_s < period_s else frame.host_s
        self._next_frame_s[pad] = begin_s + period_s
        if len(self._items) < MOST_FRAMES * len(self._next_frame_s):
            self.put((frame, pad))
        else:
            self._items.dropped += 1

    def may_drop(self, item: tuple[Item, float] | None) -> bool:
        return item is not None and super().may_drop(item[0])

    def write(self, item: tuple[Item, float]) -> None:
        """Send one item; an event that is lost with its connection is sent again over the next."""
        sent, since_s = item
        self.limit.sent += 1
        if isinstance(sent, tuple):
            self.send_frame(*sent)
            return
        self.note(sent)
        while time.monotonic() < since_s + STALE_S and not self._abandoned.is_set():
            if self._peer_is_there.wait(POLL_S):
                if self.send_event(sent):
                    return
                # The connection's thread notices soon that it has ended.
                self._abandoned.wait(POLL_S)
        self._items.dropped += 1

    def close(self) -> None:
        """Disconnect."""
        self._ending.set()
        self.hang_up()
        self._keeper.join(GOODBYE_S)

    def connected(self) -> None:
        """Note that the peer is connected, so that events can be sent."""
        is_first, self._was_there = not self._was_there, True
        self._peer_is_there.set()
        if not self._faults.end("away", f"connected to {self._where}") and is_first:
            self._log.info("%s: connected to %s", self.name, self._where)

    def note_refused(self, why: str) -> None:
        """Log that the peer refused a message, and why."""
        self._faults.begin("refused", f"the peer refused something ({why})", cause=why)

    def _run(self) -> None:
        super()._run()
        self.close()

    def _keep_connected(self) -> None:
        while not self._ending.is_set():
            self.limit = PeerLimit()
            try:
                reason = self.hold()
            except OSError as error:
                reason = f"cannot be reached: {error.strerror or error}"
            # A peer's bytes can make libraries raise undocumented errors.
            except Exception as error:
                reason = f"{type(error).__name__}: {error}"
            if self._ending.is_set():
                return
            self._peer_is_there.clear()
            away = f"{self._where} is away ({reason}); trying until it is there"
            self._faults.begin("away", away, cause=reason)
            self._ending.wait(self.retry_s)


class PeerLimit:
    """Limits what a peer may send over one connection, before a library keeps or parses it.

    sent: items that the peer received, and may answer.
    """

    def __init__(self) -> None:
        self.is_exceeded = False
        self.sent = 0
        self._began_s = time.monotonic()
        self._received = 0

    def take(self, count: int) -> bool:
        """Count received bytes; return whether they are within the limit."""
        self._received += count
        for_time = PEER_BYTES_PER_S * (time.monotonic() - self._began_s)
        most = PEER_FIRST_BYTES + for_time + PEER_BYTES_PER_ITEM * self.sent
        self.is_exceeded |= self._received > most
        return not self.is_exceeded


def arrival_s(frame: Frame) -> float:
    """Return when a frame's last byte arrived, in seconds since 1970."""
    return time.time() - (time.monotonic() - frame.host_s)
