"""Reports changes of the pad's state: to the daemon as a state, to people in the log."""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

log = logging.getLogger(__name__)

# An outage this soon after the last is the same fault, a loose plug: logged again only when it lasts.
STEADY_S = 10.0


@dataclass(frozen=True)
class SensorState:
    """The pad delivers frames ("up") or does not ("down"), and why, in words for a person."""

    state: Literal["up", "down"]
    reason: str


class Announcer:
    """Turns the reader's repeated results into one state and one log line per change.

    The first failure is a warning, its repeats are debug, recovery is one line with how long it took. Within
    an outage another cause is reported too, once it occurred twice in a row; a passing one (a device file
    that has no permissions yet) is not.
    """

    def __init__(self, emit: Callable[[SensorState], None]) -> None:
        self._emit = emit
        self._is_up = False
        self._down_since_s: float | None = None
        self._recovered_s = -math.inf
        self._is_quiet = False
        self._kinds_told: set[str] = set()
        self._last_kind = ""

    def up(self, port: str) -> None:
        if self._is_up:
            return
        reason = f"frames arrive from {port}"
        if self._down_since_s is not None:
            self._recovered_s = time.monotonic()
            reason += f" again after {self._recovered_s - self._down_since_s:.1f} s"
        log.log(logging.DEBUG if self._is_quiet else logging.INFO, "%s", reason)
        self._is_up = True
        self._down_since_s = None
        self._emit(SensorState("up", reason))

    def down(self, kind: str, reason: str, since_s: float | None = None) -> None:
        """No frames arrive, since `since_s` (now if None); `kind` tells causes apart whatever the words."""
        is_news = kind == self._last_kind and kind not in self._kinds_told
        self._last_kind = kind
        if self._down_since_s is None:
            self._is_up, is_news = False, True
            self._down_since_s = time.monotonic() if since_s is None else since_s
            self._is_quiet = self._down_since_s - self._recovered_s < STEADY_S
            self._kinds_told.clear()
        elif self._is_quiet and time.monotonic() - self._down_since_s > STEADY_S:
            self._is_quiet, is_news = False, True
        if not is_news:
            log.debug("still down: %s", reason)
            return
        self._kinds_told.add(kind)
        log.log(logging.DEBUG if self._is_quiet else logging.WARNING, "%s", reason)
        self._emit(SensorState("down", reason))
