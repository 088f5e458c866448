"""Notifies systemd (sd_notify): the daemon is ready, it works (the watchdog), its status, it ends."""

import math
import os
import socket
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress

from touchd.daemon.app.parts import PadChannel
from touchd.daemon.sinks.sink import EventFanout

STATUS_EVERY_S = 5.0
FEEDS_PER_WATCHDOG = 4
# A pad's reader that reports nothing for this long has died: it would have reported a missing pad earlier.
SILENT_S = 4.0


class Health:
    """Notifies systemd; does nothing if systemd did not start the daemon.

    Feeds the watchdog while each pad either delivers frames that are processed or is known to be away. So
    systemd restarts the daemon when a reader dies or the loop hangs.
    environ: NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID as systemd sets them (sd_notify(3),
    sd_watchdog_enabled(3)).
    """

    def __init__(self, environ: Mapping[str, str], pads: Sequence[PadChannel], events: EventFanout) -> None:
        address = environ.get("NOTIFY_SOCKET", "")
        # A name that begins with @ stands for Linux's abstract namespace.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)
        watched = environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watchdog_s = int(environ.get("WATCHDOG_USEC", "0")) / 1e6 if watched else 0.0
        self._pads = pads
        self._events = events
        # The time until which each pad counts as alive; infinite while it is known to be away.
        self._alive_until_s: dict[str, float] = {}
        self._seen: dict[str, tuple[int, bool | None]] = {}
        self._reported = 0
        self._next_feed_s = 0.0 if self.watchdog_s else math.inf
        self._status_s = time.monotonic()

    def close(self) -> None:
        self._socket.close()

    def update(self, *, is_ending: bool = False) -> bool:
        """Check the pads and report; the daemon is ready once a pad's state is known. Returns is_ending."""
        if is_ending:
            self._send(STOPPING=1)
            return True
        now_s = time.monotonic()
        for pad in self._pads:
            before, self._seen[pad.name] = self._seen.get(pad.name), (pad.frames, pad.is_up)
            if pad.is_up is None or before == (pad.frames, pad.is_up):
                continue
            if not self._alive_until_s:
                self._send(READY=1)
            self._alive_until_s[pad.name] = now_s + SILENT_S if pad.is_up else math.inf
        if now_s >= self._next_feed_s and now_s < min(self._alive_until_s.values(), default=now_s):
            self._send(WATCHDOG=1)
            self._next_feed_s = now_s + self.watchdog_s / FEEDS_PER_WATCHDOG
        if now_s - self._status_s >= STATUS_EVERY_S:
            self._report(now_s)
        return False

    def _report(self, now_s: float) -> None:
        """Report the status: frames a second, touches and dropped frames so far."""
        frames = sum(pad.frames for pad in self._pads)
        dropped = sum(pad.queue.dropped for pad in self._pads)
        rate_hz = (frames - self._reported) / (now_s - self._status_s)
        away = "".join(f", {pad.name} away" for pad in self._pads if pad.is_up is False)
        status = f"{rate_hz:.1f} frames/s{away}, {self._events.touches} touches, {dropped} frames dropped"
        self._send(STATUS=status)
        self._status_s, self._reported = now_s, frames

    def _send(self, **fields: str | int) -> None:
        """Send fields such as READY=1; ignore a manager that does not receive them."""
        if self._address:
            message = "\n".join(f"{name}={value}" for name, value in fields.items())
            with suppress(OSError):
                self._socket.sendto(message.encode(), self._address)
