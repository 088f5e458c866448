"""The pad on its serial port: a thread that reads frames, notices when they stop, and finds the pad again."""

import logging
import threading
import time

from touchd.drivers.faults import Backoff
from touchd.drivers.frame import Frame
from touchd.drivers.pad.diagnosis import RECENT_BYTES, diagnose
from touchd.drivers.pad.line_watch import LineWatch
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import Line, SensorError, at_baud, check_port, open_port, read_waiting
from touchd.drivers.pad.sensor_state import Announcer, SensorState
from touchd.drivers.queue import DroppingQueue, Signal

__all__ = ["FrameQueue", "Sensor", "SensorError", "SensorState", "check_port"]

log = logging.getLogger(__name__)

FIRST_RETRY_S = 0.1
# A diagnosis may hold up the other pads' answers; while the bytes stay wrong, it is made ever less often.
LONGEST_LOOK_S = 16.0
# Of a pad that sends far too much, the reader rests so many times as long as it took to parse a read.
FLOOD_BYTES, FLOOD_REST, LONGEST_REST_S = 16384, 9, 0.25


class FrameQueue(DroppingQueue[Frame | SensorState]):
    """What the reader hands to the daemon's loop, in order; gives up the oldest frame, never a state.

    Only when nothing but `capacity` states waits unread does a state go.
    filled: set when something is put; of several queues, one thread can wait on the same.
    """

    def __init__(self, capacity: int = 540, filled: Signal | None = None) -> None:
        super().__init__(capacity, lambda item: isinstance(item, Frame), filled)


class Sensor:
    """Reads `port` (see `touchd.drivers.pad.port`); puts frames and changes of state into `queue`.

    The port is reopened whenever it fails, after FIRST_RETRY_S and then ever longer up to longest_retry_s.
    Without a frame for silence_s the pad is down; after reopen_after_s without a byte the port is reopened
    too, which restarts an Arduino that hangs. A frame's host_s is when its last byte was read.
    """

    def __init__(
        self,
        port: str,
        baud: int,
        protocol: FrameParser,
        queue: FrameQueue,
        *,
        longest_retry_s: float = 1.0,
        silence_s: float = 2.0,
        reopen_after_s: float = 10.0,
    ) -> None:
        self._port = port
        self._baud = baud
        self._protocol = protocol
        self._queue = queue
        self._longest_retry_s = longest_retry_s
        self._backoff = Backoff(FIRST_RETRY_S, longest_retry_s)
        self._silence_s = silence_s
        self._reopen_after_s = reopen_after_s
        self._announcer = Announcer(queue.put)
        self._watch = LineWatch(protocol, self._where)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="touchd-sensor", daemon=True)

    def start(self) -> None:
        """Begin to read; returns at once."""
        self._thread.start()

    def stop(self, timeout_s: float = 1.0) -> None:
        """End reading and close the port; safe to call twice, and before `start`.

        A network address that does not answer may keep the thread some seconds longer, not this call.
        """
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def _run(self) -> None:
        while not self._stop.is_set():
            begun_s = time.monotonic()
            try:
                with open_port(self._port, self._baud) as opened:
                    self._read(opened)
            except SensorError as error:
                self._fail(error.kind, str(error))
            except Exception as error:
                # Retry after any error: a dead reader would stay down.
                log.debug("the reader of %s failed", self._port, exc_info=True)
                self._fail("internal", f"internal error while reading {self._port}: {error!r}")
            if time.monotonic() - begun_s > self._longest_retry_s:
                self._backoff.reset()
            self._stop.wait(self._backoff.pause_s())

    def _fail(self, kind: str, why: str) -> None:
        """Report a failure, unless told to stop: another reader may fill the queue by now."""
        if not self._stop.is_set():
            self._announcer.down(kind, why)

    def _read(self, opened: Line) -> None:
        """Read until stopped, or until a long silence calls for reopening the port."""
        self._protocol.reset()
        self._watch.forget_clock()
        recent = b""
        byte_s = frame_s = looked_s = time.monotonic()
        look_s = self._silence_s
        while not self._stop.is_set():
            data = read_waiting(opened, self._protocol)
            now_s = time.monotonic()
            if data:
                byte_s = now_s
                recent = (recent + data)[-RECENT_BYTES:]
                if self._hand_over(data, now_s):
                    frame_s = looked_s = now_s
                    look_s = self._silence_s
                    recent = b""
            if len(data) >= FLOOD_BYTES:
                self._stop.wait(min(FLOOD_REST * (time.monotonic() - now_s), LONGEST_REST_S))
            if now_s - byte_s > self._reopen_after_s:
                return
            if now_s - looked_s > look_s:
                looked_s = now_s
                if now_s - byte_s <= self._silence_s:
                    look_s = min(2 * look_s, LONGEST_LOOK_S)
                self._explain(recent, frame_s, is_silent=now_s - byte_s > self._silence_s)

    def _hand_over(self, data: bytes, host_s: float) -> bool:
        """Parse what arrived at `host_s`; return whether it completed a frame."""
        frames = self._protocol.feed(data, host_s)
        if frames:
            self._announcer.up(self._port)
            for frame in frames:
                self._queue.put(frame)
        self._watch.update(host_s, frames[-1].sensor_ms if frames else None)
        return bool(frames)

    def _explain(self, recent: bytes, since_s: float, *, is_silent: bool) -> None:
        """Say why no frame has come since `since_s`."""
        if is_silent:
            kind = "silent"
            reason = f"no data for {self._silence_s:g} s: is it the pad's port, and does the pad run?"
        else:
            kind, reason = diagnose(recent, self._protocol.format)
            reason += "; touchd doctor says what to set" if kind in ("format", "noise") else ""
        self._announcer.down(kind, f"{self._where}: {reason}", since_s)

    @property
    def _where(self) -> str:
        return self._port + at_baud(self._port, self._baud)
