"""What bridges share: a bounded queue, frames at a stated rate, a connection that is kept and reported."""

import logging
import threading
import time
from abc import abstractmethod

from touchd.daemon.events import Event, kind_of
from touchd.daemon.sinks import QueuedSink
from touchd.drivers.errors import TouchdError
from touchd.drivers.faults import Backoff
from touchd.drivers.frame import Frame

# One second of frames; more would only delay events.
MOST_FRAMES = 54
POLL_S = 0.05
# A connection that ends sooner is one more failed attempt: a broker may let touchd in, and then refuse it.
LASTING_S = 5.0
BACKOFF_FIRST_S, BACKOFF_CAP_S = 0.1, 2.0
# Connections that may end while one event is sent, before the event is taken for the cause.
TRIES = 3
# Minimum interval between two lines about what the peer refuses.
REFUSED_AGAIN_S = 60.0
GOODBYE_S = 1.0


class BridgeError(TouchdError):
    """A bridge cannot be used as configured; the message is one line that says what to do."""


class Bridge(QueuedSink[Event | Frame]):
    """Passes one pad's events on to another system, and its frames if wanted.

    `open`, `write` and `close` run in the sink's own thread. Events wait while the peer is away; when the
    queue is full, the oldest are dropped. Frames do not wait. Other pads' events are ignored.
    frames_hz: frames a second at most, math.inf for all, None for none.
    refused: what the peer would not take.
    """

    def __init__(self, name: str, pad: str, frames_hz: float | None) -> None:
        self.pad = pad
        self.frames_hz = frames_hz
        self.refused = 0
        self._next_frame_s = 0.0
        self._peer_is_there = threading.Event()
        self._log = logging.getLogger(f"touchd.daemon.bridges.{name}")
        self._was_away = False
        self._is_unsteady = False
        self._there_since_s = 0.0
        self._saying = threading.Timer(0.0, lambda: None)
        self._backoff = Backoff(BACKOFF_FIRST_S, BACKOFF_CAP_S)
        self._refused_unsaid = 0
        self._say_refused_s = 0.0
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
        if self._refused_unsaid:
            self._log.warning("%s: %d more were refused until the end", self.name, self._refused_unsaid)

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

    def _tell_away(self, where: str, reason: str, *, is_news: bool = False) -> bool:
        """Log once that the peer is away, however many attempts fail; returns whether it was logged.

        is_news: log it again, since the reason is another one.
        """
        self._saying.cancel()
        if self._peer_is_there.is_set():
            was_unsteady = self._is_unsteady
            self._is_unsteady = time.monotonic() - self._there_since_s < LASTING_S
            if not (was_unsteady and self._is_unsteady):
                self._backoff.reset()
        self._peer_is_there.clear()
        is_logged = (is_news or not self._was_away) and not self._draining
        if is_logged:
            self._log.warning("%s: %s is away (%s); trying until it is there", self.name, where, reason)
        self._was_away = True
        return is_logged

    def _note_refused(self, why: str) -> None:
        """Count something that the peer would not take; log the first at once, then one line a minute."""
        self.refused += 1
        self._refused_unsaid += 1
        if time.monotonic() >= self._say_refused_s:
            self._say_refused_s = time.monotonic() + REFUSED_AGAIN_S
            count, self._refused_unsaid = self._refused_unsaid, 0
            more = f"; {count} in the last minutes" if count > 1 else ""
            self._log.warning("%s: the peer refused something (%s)%s", self.name, why, more)


class ConnectedBridge(Bridge):
    """A bridge over a connection, which a thread of its own keeps.

    where: the peer's address, for the log.
    """

    def __init__(self, name: str, pad: str, frames_hz: float | None, where: str) -> None:
        self._where = where
        self._connection_number = 0
        self._ending = threading.Event()
        self._keeper = threading.Thread(target=self._keep_connected, name=f"touchd-{name}-link", daemon=True)
        super().__init__(name, pad, frames_hz)

    @abstractmethod
    def hold(self) -> str:
        """Connect, call `connected`, and return why the connection ended; runs in the keeper's thread.

        Whatever it raises is the reason.
        """

    @abstractmethod
    def send_event(self, event: Event) -> bool:
        """Send an event over the present connection; False if that ended before the peer had the event."""

    @abstractmethod
    def send_frame(self, frame: Frame) -> None:
        """Send a frame, or drop it."""

    @abstractmethod
    def hang_up(self) -> None:
        """End the present connection, if any, so that `hold` returns soon."""

    def open(self) -> None:
        self._keeper.start()

    def write(self, item: Event | Frame) -> None:
        """Send one item. An event is sent again over the next connection if this one is lost."""
        if isinstance(item, Frame):
            self.send_frame(item)
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
        """Note that events can be sent."""
        self._connection_number += 1
        self._tell_there(self._where)

    def _await_connection(self, after: int) -> int:
        """Wait for a connection other than number `after`; returns its number, 0 when the sink is to end."""
        while not self._abandoned.is_set():
            if self._peer_is_there.wait(POLL_S) and self._connection_number != after:
                return self._connection_number
            if self._peer_is_there.is_set():
                self._abandoned.wait(POLL_S)
        return 0

    def _keep_connected(self) -> None:
        was_out_of_reach = False
        while not self._ending.is_set():
            is_out_of_reach = False
            try:
                reason = self.hold()
            except OSError as error:
                is_out_of_reach = True
                reason = f"cannot be reached: {error.strerror or error}"
            # What a peer sends makes libraries raise what they do not document.
            except Exception as error:
                reason = f"{type(error).__name__}: {error}"
            # Why a peer that was reached at last does not let touchd in is news.
            is_news = was_out_of_reach and not is_out_of_reach
            if self._tell_away(self._where, reason, is_news=is_news):
                was_out_of_reach = is_out_of_reach
            self._ending.wait(self._backoff.pause_s())


class Allowance:
    """How many bytes a peer may send: some at once, a few a second, and some for each message to it.

    touchd subscribes to nothing, so a peer has little to say. Libraries keep or parse what it sends all the
    same, so its bytes are limited before a library sees them.
    """

    def __init__(self, first: int, for_each: int, per_s: float = 16.0) -> None:
        self._left = float(first)
        self._for_each = for_each
        self._per_s = per_s
        self._counted_s = time.monotonic()
        self.is_spent = False

    def sent(self) -> None:
        """Note that a message was sent to the peer."""
        self._left += self._for_each

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
