"""The pad on its port: a thread that reads frames, notices when they stop, and finds the pad again."""

import logging
import math
import threading
import time

from touchd.drivers.faults import Backoff
from touchd.drivers.frame import Frame, SensorState
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import (
    Port,
    SensorError,
    at_baud,
    open_port,
    other_ports,
    read_waiting,
    reads_all,
)
from touchd.drivers.queue import DroppingQueue, Signal

log = logging.getLogger(__name__)

FIRST_RETRY_S = 0.1
# A loop that took longer was suspended, so missing bytes prove nothing about the pad.
PAUSED_S = 1.0
# After a read of FLOOD_BYTES, sleep FLOOD_REST times the parse time, at most LONGEST_REST_S.
FLOOD_BYTES, FLOOD_REST, LONGEST_REST_S = 16384, 9, 0.25
# A frame period at 54 Hz, with some jitter. Linux buffers 4096 bytes of a port: sleep at most while half of
# them arrive.
FRAME_S, HALF_BUFFER_BYTES = 0.0186, 2048


class FrameQueue(DroppingQueue[Frame | SensorState]):
    """Passes frames and states from the reader to the daemon's loop, in order; bounded.

    When it is full, the oldest frame is dropped. States are dropped only when the queue holds nothing else.
    filled: set when something is put; several queues can share one, for a thread that waits on all.
    """

    def __init__(self, capacity: int = 540, filled: Signal | None = None) -> None:
        super().__init__(capacity, lambda item: isinstance(item, Frame), filled)


class Sensor:
    """Reads `port` (see `touchd.drivers.pad.port`); puts frames and states into `queue`.

    A state "up" comes before the first frame of an opened port; a state "down" after each failed attempt, and
    every `silence_s` without frames. A frame's host_s is when its last byte was read.
    longest_retry_s: a port that failed is reopened after FIRST_RETRY_S, then after longer pauses up to this.
    silence_s: the pad is down after this long without a frame, and for as long after another program took
    bytes. reopen_after_s: without a byte, the port is reopened, which restarts an Arduino that hangs.
    frameless_s: without a frame, it is reopened too, as another program may have changed its settings.
    frames_together: how many frames may be read at once, of a pad with a clock.
    parser: turns the port's bytes into frames; its counts may be read from any thread.
    """

    longest_retry_s, silence_s, reopen_after_s, frameless_s = 1.0, 2.0, 10.0, 30.0

    def __init__(self, port: str, baud: int, parser: FrameParser, queue: FrameQueue) -> None:
        self._port = port
        self._baud = baud
        self.parser = parser
        self._queue = queue
        self._is_up = False
        # Set by the thread that takes the frames: a question from here would make it wait.
        self.frames_together = 1
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="touchd-sensor", daemon=True)

    def start(self) -> None:
        """Begin to read; returns at once."""
        self._thread.start()

    def stop(self, timeout_s: float = 1.0) -> None:
        """Stop reading and close the port; idempotent, also before `start`.

        If a network address does not answer, the thread may outlive this call by some seconds.
        """
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def _run(self) -> None:
        backoff = Backoff(FIRST_RETRY_S, self.longest_retry_s)
        while not self._stop.is_set():
            begun_s = time.monotonic()
            try:
                with open_port(self._port, self._baud) as opened:
                    self._read(opened)
            except SensorError as error:
                # The pad may have come back under another name: then that is news.
                where = other_ports(self._port) if error.kind == "missing" else []
                self._report_down(" ".join((error.kind, *where)), str(error))
            except Exception as error:
                # Retry after any error: a dead reader would stay down.
                log.debug("the reader of %s failed", self._port, exc_info=True)
                self._report_down("internal", f"internal error while reading {self._port}: {error!r}")
            if time.monotonic() - begun_s > self.longest_retry_s:
                backoff.reset()
            self._stop.wait(backoff.pause_s())

    def _read(self, opened: Port) -> None:
        """Read until stopped, or until the port should be opened again."""
        self.parser.reset()
        has_bytes, shared_s = False, -math.inf
        read_s = byte_s = frame_s = reported_s = time.monotonic()
        while not self._stop.is_set():
            try:
                data = read_waiting(opened, self.parser)
            except SensorError as error:
                if error.kind != "shared":
                    raise
                # Keep the port open: opening it again would restart an Arduino.
                shared_s = reported_s = time.monotonic()
                self._report_down(error.kind, str(error))
                self._stop.wait(FIRST_RETRY_S)
                continue
            now_s = time.monotonic()
            took_s, read_s = now_s - read_s, now_s
            if took_s > PAUSED_S:
                byte_s = frame_s = now_s
            if data:
                if not has_bytes:
                    # The first of these bytes may be half a frame.
                    reported_s = now_s
                has_bytes, byte_s = True, now_s
                frames = self.parser.feed(data, now_s)
                if frames and now_s - shared_s > self.silence_s:
                    has_bytes, frame_s = False, now_s
                    self._hand_over(frames)
                self._rest(opened, len(data), took_s, now_s, has_frames=bool(frames))
            if now_s - byte_s > self.reopen_after_s or now_s - frame_s > self.frameless_s:
                return
            if now_s - max(frame_s, reported_s) > self.silence_s:
                reported_s, has_bytes = now_s, False
                cause, what = "no frames", f"bytes come, but no frame of {self.parser.format}"
                if now_s - byte_s > self.silence_s:
                    cause, what = "silent", f"no data for {self.silence_s:g} s"
                self._report_down(cause, f"{self._port}{at_baud(self._port, self._baud)}: {what}")

    def _rest(self, opened: Port, size: int, took_s: float, now_s: float, *, has_frames: bool) -> None:
        """Sleep after a read of `size` bytes that came within `took_s`: for more frames, or in a flood."""
        if size >= FLOOD_BYTES:
            # Leave the processor to others.
            self._stop.wait(min(FLOOD_REST * (time.monotonic() - now_s), LONGEST_REST_S))
        elif has_frames and self.frames_together > 1 and self.parser.dates_frames and reads_all(opened):
            time.sleep(min(FRAME_S * self.frames_together, took_s * HALF_BUFFER_BYTES / size))

    def _hand_over(self, frames: list[Frame]) -> None:
        if not self._is_up:
            self._is_up = True
            self._queue.put(SensorState("up", f"frames arrive from {self._port}"))
        self._queue.put_all(frames)

    def _report_down(self, cause: str, reason: str) -> None:
        """Report that no frames come, unless stopped: another reader may fill the queue by now."""
        if not self._stop.is_set():
            self._is_up = False
            self._queue.put(SensorState("down", f"{reason}; touchd doctor says more", cause))
