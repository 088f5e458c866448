"""Pseudo-terminals to open as a pad's serial port; they play a stream, or send what a simulated pad reads."""

import array
import fcntl
import itertools
import math
import os
import pty
import select
import tempfile
import termios
import threading
import time
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.errors import TouchdError, os_errors_as
from touchd.drivers.frame import FRAME_RATE_HZ, Counts
from touchd.drivers.recording import Stream

POLL_S = 0.002
# pyserial discards pending input just after opening a port; wait this long for a reader that does not.
SETTLE_S = 0.5
# The kernel flushes asynchronously; check again after this long.
EMPTY_FOR_S = 0.1


T = TypeVar("T", bound="_FakePty")


class _FakePty(ABC):
    """A pseudo-terminal, and the thread that sends through it."""

    def __init__(self) -> None:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="touchd-fake-port", daemon=True)
        with os_errors_as(TouchdError, "no pseudo-terminal for the simulated pad", "is /dev/pts mounted?"):
            self._master, slave = pty.openpty()
        tty.setraw(slave)
        # Linux reuses the numbers of ptys: a reader that looks for its lost pad by number would open, and
        # disturb, another program's terminal.
        self._folder = tempfile.TemporaryDirectory(prefix="touchd-pad-")
        self.path = str(Path(self._folder.name) / "pad")
        os.symlink(os.ttyname(slave), self.path)
        # With the slave closed here, the master hangs up whenever no reader has it open.
        os.close(slave)
        os.set_blocking(self._master, False)
        # Packet mode reports when the reader discards its input.
        fcntl.ioctl(self._master, termios.TIOCPKT, array.array("i", [1]))
        self._hangup = select.poll()
        self._hangup.register(self._master, 0)

    @abstractmethod
    def _run(self) -> None:
        """Send until stopped."""

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def stop(self) -> None:
        """Hang up: the reader sees the device disappear, and `path` is gone. May be repeated."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._master >= 0:
            self._folder.cleanup()
            os.close(self._master)
            self._master = -1

    def __enter__(self: T) -> T:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _has_reader(self) -> bool:
        return not self._hangup.poll(0)

    def _discards_input(self) -> bool:
        """Take what a reader has sent; whether one has discarded its input since this was last asked."""
        try:
            return bool(os.read(self._master, 4096)[0] & termios.TIOCPKT_FLUSHREAD)
        except OSError:
            return False


class LivePort(_FakePty):
    """Sends a frame 54 times a second; frames that nobody reads are lost, as with a real pad.

    scan: returns what the pad reads now, given the sensor's clock in ms. encode: as for `FakePort`.
    """

    def __init__(self, scan: Callable[[int], Counts], encode: Callable[[Counts, int], bytes]) -> None:
        self._scan, self._encode = scan, encode
        super().__init__()

    def _run(self) -> None:
        begun_s = time.monotonic()
        for number in itertools.count():
            elapsed_s = number / FRAME_RATE_HZ
            if self._stop.wait(max(0.0, begun_s + elapsed_s - time.monotonic())):
                return
            sensor_ms = round(1000 * elapsed_s)
            counts = self._scan(sensor_ms)
            # A reader that does not keep up loses bytes; what one sends is discarded.
            with suppress(OSError):
                if self._has_reader():
                    os.write(self._master, self._encode(counts, sensor_ms))
            self._discards_input()


class FakePort(_FakePty):
    """Plays `stream` through a pty from the moment a reader opens `path`.

    encode: turns counts (8, 8) and a clock in ms into the bytes of one frame. speed: 1 keeps the stream's own
    pace by an absolute schedule, N is N times faster, as far as the reader keeps up. loop: starts over while
    the clock continues. Frames that are due while nobody has it open are lost.
    sent_s: (T,) float64, `time.monotonic()` just before a frame's last byte was written, NaN until then.
    """

    def __init__(
        self,
        stream: Stream,
        encode: Callable[[Counts, int], bytes],
        *,
        speed: float = 1.0,
        loop: bool = False,
    ) -> None:
        self._stream, self._encode, self._speed, self._loop = stream, encode, speed, loop
        self.sent_s: NDArray[np.float64] = np.full(len(stream.counts), np.nan)
        self._finished, self._drained = threading.Event(), False
        super().__init__()

    def wait(self, timeout_s: float) -> bool:
        """Return True once the reader took everything; False after `timeout_s` or if the reader left."""
        return self._finished.wait(timeout_s) and self._drained

    def _run(self) -> None:
        try:
            if self._await_reader():
                self._play()
                self._drained = self._await_empty()
        finally:
            self._finished.set()

    def _play(self) -> None:
        begin_s = time.monotonic()
        for index, sensor_ms, elapsed_ms in self._schedule():
            packet = self._encode(self._stream.counts[index], sensor_ms)
            if self._stop.wait(max(0.0, begin_s + elapsed_ms / 1000 / self._speed - time.monotonic())):
                return
            self._send(index, packet)

    def _schedule(self) -> Iterator[tuple[int, int, int]]:
        """Yield each frame's index in the stream, its clock, and when it is due, in ms."""
        period_ms = round(1000 / FRAME_RATE_HZ)
        steps_ms = np.diff(self._stream.sensor_ms)
        # If the clock restarts, time still runs forward.
        due_ms = np.concatenate([[0], np.cumsum(np.where(steps_ms < 0, period_ms, steps_ms))]).tolist()
        stamps_ms = self._stream.sensor_ms.tolist()
        for turn in itertools.count() if self._loop else [0]:
            later_ms = turn * (due_ms[-1] + period_ms)
            for index, (stamp_ms, elapsed_ms) in enumerate(zip(stamps_ms, due_ms, strict=True)):
                yield index, stamp_ms + later_ms, elapsed_ms + later_ms

    def _send(self, index: int, packet: bytes) -> None:
        sent = 0
        while sent < len(packet) and not self._stop.is_set() and self._has_reader():
            now_s = time.monotonic()
            try:
                sent += os.write(self._master, packet[sent:])
                self.sent_s[index] = now_s
            except BlockingIOError:
                self._stop.wait(POLL_S)

    def _await_reader(self) -> bool:
        """Wait until a reader has opened the port and discarded what waited in it; False when stopped."""
        settled_s = math.inf
        while not self._stop.wait(POLL_S):
            # Ask before looking for a reader, to forget what an earlier one did.
            has_discarded = self._discards_input()
            now_s = time.monotonic()
            settled_s = min(settled_s, now_s + SETTLE_S) if self._has_reader() else math.inf
            if settled_s < math.inf and (has_discarded or now_s >= settled_s):
                return True
        return False

    def _await_empty(self) -> bool:
        """Wait until the reader has taken every byte; False when it left or the port was stopped."""
        full_s, waiting = time.monotonic(), array.array("i", [0])
        while self._has_reader() and not self._stop.wait(POLL_S):
            slave = os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            fcntl.ioctl(slave, termios.FIONREAD, waiting)
            os.close(slave)
            now_s = time.monotonic()
            if waiting[0]:
                full_s = now_s
            elif now_s - full_s >= EMPTY_FOR_S:
                return True
        return False
