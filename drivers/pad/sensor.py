"""The pad on its port: a thread that reads frames, notices when they stop, and finds the pad again."""

import logging
import threading
import time

from touchd.drivers.faults import Backoff
from touchd.drivers.frame import Frame, SensorState
from touchd.drivers.pad.arrived import why_no_frame
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import Line, at_baud, open_port, read_waiting, reads_all
from touchd.drivers.pad.why_not import SensorError, programs_at, shared
from touchd.drivers.queue import DroppingQueue, Signal

log = logging.getLogger(__name__)

FIRST_RETRY_S = 0.1
# A loop that took longer was suspended, so missing bytes prove nothing about the pad.
PAUSED_S = 1.0
# After a read of FLOOD_BYTES, sleep FLOOD_REST times the parse time, at most LONGEST_REST_S.
FLOOD_BYTES, FLOOD_REST, LONGEST_REST_S = 16384, 9, 0.25
# A frame's time at 54 Hz, with a little for jitter. Linux keeps 4096 bytes of a port: a read is put off for
# twice the frames that the last one brought, at most, for no longer than half as many bytes take, and not at
# all if the last one brought as many.
FRAME_S, MOST_UNHURRIED_BYTES = 0.0186, 2048
# At this rate many boards start their boot loader when the port is closed.
BOOT_BAUD = 1200
# After it was reopened this often without a byte, the board needs a person.
SILENT_OPENINGS = 3
# Enough for a few frames.
RECENT_BYTES = 32768


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
    every `silence_s` without frames. The port is reopened whenever it fails, after FIRST_RETRY_S and then
    ever longer up to longest_retry_s. Without a frame for silence_s the pad is down. After reopen_after_s
    without a byte the port is reopened, which restarts an Arduino that hangs; after frameless_s without a
    frame too, for another program may have set it differently. A frame's host_s is when its last byte was
    read.
    frames_together: for how many frames' time the reader may rest after one, of a pad with a clock.
    parser: turns the port's bytes into frames; its counts may be read from any thread.
    """

    longest_retry_s, silence_s, reopen_after_s, frameless_s = 1.0, 2.0, 10.0, 30.0

    def __init__(self, port: str, baud: int, parser: FrameParser, queue: FrameQueue) -> None:
        self._port = port
        self._baud = baud
        self.parser = parser
        self._queue = queue
        self._is_up = False
        self._is_shared = False
        self._silent_openings = 0
        # Set by the thread that takes the frames: asking it here would hold that thread up.
        self.frames_together: float = 1
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="touchd-sensor", daemon=True)

    @property
    def where(self) -> str:
        """The port, with its baud rate where it has one."""
        return self._port + at_baud(self._port, self._baud)

    def start(self) -> None:
        """Begin to read; returns at once."""
        if self._baud == BOOT_BAUD and "://" not in self._port:
            log.warning(
                "%s: closing a port at 1200 baud starts the boot loader of many boards; set the baud rate of "
                "the pad's firmware",
                self._port,
            )
        self._thread.start()

    def stop(self, timeout_s: float = 1.0) -> None:
        """End reading and close the port; safe to call twice, and before `start`.

        A network address that does not answer may keep the thread some seconds longer, not this call.
        """
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def _run(self) -> None:
        backoff = Backoff(FIRST_RETRY_S, self.longest_retry_s)
        while not self._stop.is_set():
            begun_s = time.monotonic()
            try:
                # Opening restarts an Arduino, so wait for the other program to leave first.
                if self._is_shared and (programs := programs_at(self._port)):
                    raise shared(self._port, programs)
                self._is_shared = False
                with open_port(self._port, self._baud) as opened:
                    self._read(opened)
            except SensorError as error:
                self._is_shared = error.kind == "shared"
                self._report_down(error.kind, str(error))
            except Exception as error:
                # Retry after any error: a dead reader would stay down.
                log.debug("the reader of %s failed", self._port, exc_info=True)
                self._report_down("internal", f"internal error while reading {self._port}: {error!r}")
            if time.monotonic() - begun_s > self.longest_retry_s:
                backoff.reset()
            self._stop.wait(backoff.pause_s())

    def _read(self, opened: Line) -> None:
        """Read until stopped, or until the port should be opened again."""
        self.parser.reset()
        self._silent_openings += 1
        recent = b""
        can_wait = reads_all(opened)
        read_s = byte_s = frame_s = reported_s = time.monotonic()
        while not self._stop.is_set():
            data = read_waiting(opened, self.parser)
            now_s = time.monotonic()
            took_s, read_s = now_s - read_s, now_s
            if took_s > PAUSED_S:
                byte_s = frame_s = now_s
            if data:
                byte_s = now_s
                self._silent_openings = 0
                if not recent:
                    # The first of these bytes may be half a frame, or frames whose clock is not yet known.
                    reported_s = now_s
                recent = (recent + data)[-RECENT_BYTES:]
                if frames := self._hand_over(data, now_s):
                    frame_s, recent = now_s, b""
                    is_dated = self.parser.dates_frames and len(data) < MOST_UNHURRIED_BYTES
                    if can_wait and is_dated and self.frames_together > 1:
                        together_s = FRAME_S * min(self.frames_together, 2 * frames)
                        time.sleep(min(together_s, took_s * MOST_UNHURRIED_BYTES / len(data)))
                if len(data) >= FLOOD_BYTES:
                    # Leave the processor to others.
                    self._stop.wait(min(FLOOD_REST * (time.monotonic() - now_s), LONGEST_REST_S))
            if now_s - byte_s > self.reopen_after_s or now_s - frame_s > self.frameless_s:
                return
            if now_s - max(frame_s, reported_s) > self.silence_s:
                reported_s, is_silent = now_s, now_s - byte_s > self.silence_s
                self._report_no_frames(recent, is_silent=is_silent)
                recent = b"" if is_silent else recent

    def _hand_over(self, data: bytes, host_s: float) -> int:
        """Parse what arrived at `host_s`; return how many frames it completed."""
        frames = self.parser.feed(data, host_s)
        if frames and not self._is_up:
            self._is_up = True
            self._queue.put(SensorState("up", f"frames arrive from {self._port}"))
        if frames:
            self._queue.put_all(frames)
        return len(frames)

    def _report_no_frames(self, recent: bytes, *, is_silent: bool) -> None:
        """Report that no frames come, and what comes instead."""
        is_udp, is_serial = self._port.startswith("udp://"), "://" not in self._port
        cause = "silent"
        if not is_silent:
            cause, why = why_no_frame(self.parser.format, recent)
        elif self._silent_openings > SILENT_OPENINGS and not is_udp:
            repair = "unplug it, and plug it in again" if is_serial else "switch it off and on"
            why = f"the board takes the port but says nothing, also after it was opened again; {repair}"
            cause = "mute"
        else:
            question = "is it the pad's port, and does the pad run?"
            if is_udp:
                question = "does the board run, and send to this machine and port?"
            why = f"no data for {self.silence_s:g} s: {question}"
        self._report_down(cause, f"{self.where}: {why}")

    def _report_down(self, cause: str, reason: str) -> None:
        """Report that no frames come, unless stopped: another reader may fill the queue by now."""
        if not self._stop.is_set():
            self._is_up = False
            self._queue.put(SensorState("down", reason, cause))
