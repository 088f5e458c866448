"""What all bridges share: a bounded queue, a thread that owns the library, and frames at a stated rate."""

import logging
import threading
import time
from abc import abstractmethod

from touchd.daemon.events import Event
from touchd.daemon.sinks import QueuedSink
from touchd.drivers.backoff import Backoff
from touchd.drivers.errors import TouchdError
from touchd.drivers.frame import Frame

# One second of frames; more would only delay events.
MOST_FRAMES = 54
POLL_S = 0.05
# A connection that ends sooner is one more failed attempt: a broker may let touchd in, and then refuse it.
LASTING_S = 5.0
BACKOFF_FIRST_S, BACKOFF_CAP_S = 0.1, 2.0


class BridgeError(TouchdError):
    """A bridge cannot be used as configured; the message is one line that says what to do."""


class Bridge(QueuedSink[Event | Frame]):
    """Passes one pad's events on to another system, and its frames where they are wanted.

    `open`, `write` and `close` run in the sink's own thread. Events wait while the peer is away, the oldest
    are dropped when the queue is full; frames are not queued then. Other pads' events are ignored.
    frames_hz: frames a second at most, math.inf for all, None for none.
    """

    def __init__(self, name: str, pad: str, frames_hz: float | None) -> None:
        self.pad = pad
        self.frames_hz = frames_hz
        self._next_frame_s = 0.0
        self._peer_is_there = threading.Event()
        self._log = logging.getLogger(f"touchd.daemon.bridges.{name}")
        self._was_away = False
        self._is_unsteady = False
        self._there_since_s = 0.0
        self._saying = threading.Timer(0.0, lambda: None)
        self._backoff = Backoff(BACKOFF_FIRST_S, BACKOFF_CAP_S)
        super().__init__(name)

    def put(self, item: Event | Frame) -> None:
        """Queue an event of this pad or of the robot; never blocks."""
        if getattr(item, "pad", self.pad) == self.pad:
            super().put(item)

    def put_frame(self, frame: Frame) -> None:
        """Queue a frame if one is due and there is somebody to send it to; never blocks."""
        if self.frames_hz is None or not self._peer_is_there.is_set() or frame.host_s < self._next_frame_s:
            return
        period_s = 1.0 / self.frames_hz
        # A late frame does not delay those after it, unless there was a pause.
        is_late = frame.host_s - self._next_frame_s < period_s
        self._next_frame_s = (self._next_frame_s if is_late else frame.host_s) + period_s
        if len(self._items) < MOST_FRAMES:
            self.put(frame)
        else:
            self._items.dropped += 1

    @abstractmethod
    def open(self) -> None:
        """Make what the library needs; must not wait for the peer."""

    @abstractmethod
    def close(self) -> None:
        """Say goodbye and free what `open` made."""

    def _run(self) -> None:
        try:
            self.open()
            super()._run()
            self.close()
        except Exception:
            self._log.exception("%s has failed; the daemon goes on without it", self.name)

    def _await_peer(self) -> bool:
        """Wait until the peer is there; returns False when the sink is to end instead."""
        while not self._peer_is_there.wait(POLL_S):
            if self._abandoned.is_set():
                return False
        return True

    def _tell_there(self, where: str) -> None:
        """Note that the peer is there; log it, once it lasts where the last connection did not."""
        self._there_since_s = time.monotonic()
        self._peer_is_there.set()
        if self._is_unsteady:
            self._saying = threading.Timer(LASTING_S, self._say_there, [where])
            self._saying.daemon = True
            self._saying.start()
        else:
            self._say_there(where)

    def _say_there(self, where: str) -> None:
        self._log.info("%s: connected to %s", self.name, where)
        self._was_away = self._is_unsteady = False

    def _tell_away(self, where: str, reason: str, *, is_news: bool = False) -> None:
        """Log once that the peer is away, however many attempts fail; is_news: for another reason now."""
        self._saying.cancel()
        if self._peer_is_there.is_set():
            was_unsteady = self._is_unsteady
            self._is_unsteady = time.monotonic() - self._there_since_s < LASTING_S
            if not (was_unsteady and self._is_unsteady):
                self._backoff.reset()
        self._peer_is_there.clear()
        if (is_news or not self._was_away) and not self._draining:
            self._log.warning("%s: %s is away (%s); trying until it is there", self.name, where, reason)
        self._was_away = True


def arrival_s(frame: Frame) -> float:
    """Return when a frame's last byte arrived, in seconds since 1970."""
    return time.time() - (time.monotonic() - frame.host_s)
