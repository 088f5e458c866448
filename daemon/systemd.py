"""What systemd is told if it started the daemon (sd_notify): ready, the watchdog after work, a status."""

import math
import os
import socket
import time
from collections.abc import Mapping
from contextlib import suppress

STATUS_EVERY_S = 5.0
FEEDS_PER_WATCHDOG = 4
# Without frames for this long, a pad's reader has died: it would have reported earlier that the pad is away.
SILENT_S = 4.0


class Notifier:
    """Sends readiness, watchdog and status to systemd; does nothing without a manager.

    environ: NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID as systemd sets them (sd_notify(3),
    sd_watchdog_enabled(3)).
    """

    def __init__(self, environ: Mapping[str, str]) -> None:
        address = environ.get("NOTIFY_SOCKET", "")
        # A name that begins with @ stands for Linux's abstract namespace.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._socket: socket.socket | None = None
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
        watched = environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watchdog_s = int(environ.get("WATCHDOG_USEC", "0")) / 1e6 if watched else 0.0

    def send(self, **fields: str | int) -> None:
        """Send fields such as READY=1; a manager that does not take them is ignored."""
        if self._socket is not None:
            message = "\n".join(f"{name}={value}" for name, value in fields.items())
            with suppress(OSError):
                self._socket.sendto(message.encode(), self._address)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class Health:
    """Feeds the watchdog while each pad either delivers frames that are processed or is known to be away.

    When a reader dies or the loop hangs, systemd restarts the daemon.
    """

    def __init__(self, notifier: Notifier) -> None:
        self._notifier = notifier
        # The time until which each pad counts as alive; infinite while it is known to be away.
        self._alive_until_s: dict[str, float] = {}
        self._frames = 0
        self._reported = 0
        self._next_feed_s = 0.0 if notifier.watchdog_s else math.inf
        self._status_s = time.monotonic()

    def pad_state(self, pad: str, up: bool) -> None:
        """Note that a pad was found or is known to be away; the first call reports the daemon as ready."""
        if not self._alive_until_s:
            self._notifier.send(READY=1)
        self._alive_until_s[pad] = time.monotonic() + SILENT_S if up else math.inf
        self.feed()

    def frame_processed(self, pad: str) -> None:
        """Note that a frame went through a pad's pipeline."""
        self._alive_until_s[pad] = time.monotonic() + SILENT_S
        self._frames += 1
        self.feed()

    def feed(self) -> None:
        """Feed the watchdog if every pad is alive."""
        now_s = time.monotonic()
        if now_s >= self._next_feed_s and self._alive_until_s and now_s < min(self._alive_until_s.values()):
            self._notifier.send(WATCHDOG=1)
            self._next_feed_s = now_s + self._notifier.watchdog_s / FEEDS_PER_WATCHDOG

    def report(self, touches: int, dropped: int) -> None:
        """Report the status every few seconds: frames a second, touches and dropped frames so far."""
        now_s = time.monotonic()
        passed_s = now_s - self._status_s
        if passed_s < STATUS_EVERY_S:
            return
        rate_hz = (self._frames - self._reported) / passed_s
        away = "".join(f", {pad} away" for pad, until_s in self._alive_until_s.items() if until_s == math.inf)
        status = f"{rate_hz:.1f} frames/s{away}, {touches} touches, {dropped} frames dropped"
        self._notifier.send(STATUS=status)
        self._status_s, self._reported = now_s, self._frames

    def stopping(self) -> None:
        self._notifier.send(STOPPING=1)
