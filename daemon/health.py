"""What systemd is told of the daemon: ready once, alive only by what it did, and how it fares."""

from __future__ import annotations

import logging
import time

from daemon.notify import Notifier

log = logging.getLogger(__name__)

STATUS_EVERY_S = 5.0
FEEDS_PER_WATCHDOG = 4


class Health:
    """Feeds the watchdog after a processed frame or while the pad is known to be away, and from nothing else.

    A reader that died, or a loop that hangs, does neither, and systemd starts the daemon again.
    """

    def __init__(self, notifier: Notifier) -> None:
        self._notifier = notifier
        self._ready = False
        self._pad_is_away = False
        self._frames = 0
        self._frames_in_all = 0
        self._dropped = 0
        self._next_feed_s = 0.0
        self._status_s = time.monotonic()

    def pad_state(self, up: bool) -> None:
        """The pad was found or is known to be away; the first time, the daemon is ready."""
        self._pad_is_away = not up
        if not self._ready:
            self._ready = True
            self._notifier.send(READY=1)
        self._feed()

    def frame_processed(self) -> None:
        """A frame went through the pipeline."""
        self._frames += 1
        self._frames_in_all += 1
        self._feed()

    def idle(self) -> None:
        """No frame came for a while."""
        if self._pad_is_away:
            self._feed()

    def report(self, touches: int, dropped: int) -> None:
        """Say every few seconds how it goes: frames a second, touches so far, frames dropped so far."""
        now_s = time.monotonic()
        passed_s = now_s - self._status_s
        if passed_s < STATUS_EVERY_S:
            return
        if dropped > self._dropped:
            log.warning("%d frames dropped: the machine is too busy for the pad", dropped - self._dropped)
            self._dropped = dropped
        pad = "pad away" if self._pad_is_away else f"{self._frames / passed_s:.1f} frames/s"
        self._notifier.send(STATUS=f"{pad}, {touches} touches, {dropped} frames dropped")
        self._status_s = now_s
        self._frames = 0

    def end(self, touches: int, dropped: int) -> None:
        """Say what it was in all."""
        log.info("%d frames, %d touches, %d frames dropped in all", self._frames_in_all, touches, dropped)

    def _feed(self) -> None:
        now_s = time.monotonic()
        if self._notifier.watchdog_s and now_s >= self._next_feed_s:
            self._notifier.send(WATCHDOG=1)
            self._next_feed_s = now_s + self._notifier.watchdog_s / FEEDS_PER_WATCHDOG
