"""Things that fail and come back: how long to wait before another attempt, and how often to log it."""

import logging
import math
import random
import time
from dataclasses import dataclass, field

# A fault that comes back is logged once it has lasted this long, then twice as long, up to FORGOTTEN_S. One
# that was away for FORGOTTEN_S is a new fault; one that was away for less than STEADY_S never ended.
LASTS_S, FORGOTTEN_S, STEADY_S = 10.0, 600.0, 5.0
# Causes reported of one fault while it lasts; they may be texts of a peer.
MOST_CAUSES = 8


class Backoff:
    """Pauses that double from the first to the cap, each shortened at random by up to half."""

    def __init__(self, first_s: float, cap_s: float) -> None:
        self._first_s = first_s
        self._cap_s = cap_s
        self._next_s = first_s

    def pause_s(self) -> float:
        """Return how long to wait now, in seconds."""
        pause_s = self._next_s
        self._next_s = min(2 * pause_s, self._cap_s)
        return pause_s * random.uniform(0.5, 1.0)

    def reset(self) -> None:
        self._next_s = self._first_s


@dataclass
class _Fault:
    """patience_s: how long it must last to be logged. ended_s, logged_s: -inf before that happened.

    causes: those reported since it began. last_cause: of the last report.
    """

    since_s: float
    ended_s: float = -math.inf
    logged_s: float = -math.inf
    lasts: bool = False
    is_logged: bool = False
    patience_s: float = 0.0
    causes: set[str] = field(default_factory=set)
    last_cause: str = ""


class FaultLog:
    """Logs a fault when it begins and when it ends; one that flaps is logged ever less often.

    The first time, a fault is a warning at once. When it comes back, it is a warning after it has lasted for
    LASTS_S, and each warning doubles that time. While it lasts, another cause is a warning too once it was
    reported twice in a row: a single one may be passing. Everything else goes to debug.
    log: what to log to. prefix: begins every line. Times are `time.monotonic()`, by default the current one.
    """

    def __init__(self, log: logging.Logger, prefix: str = "") -> None:
        self._log = log
        self._prefix = prefix
        self._faults: dict[str, _Fault] = {}

    def begin(self, kind: str, what: str, now_s: float | None = None, cause: str = "") -> bool:
        """Note that a fault has begun or still lasts; to be repeated while it lasts.

        Returns whether this is news: the fault has just begun, or has another cause.
        """
        now_s = time.monotonic() if now_s is None else now_s
        fault = self._faults.get(kind)
        if fault is None or (not fault.lasts and now_s - fault.ended_s > FORGOTTEN_S):
            fault = self._faults[kind] = _Fault(now_s)
        is_news = not fault.lasts
        if is_news:
            # A fault that never really ended has lasted since its last warning.
            is_steady = now_s - fault.ended_s >= STEADY_S
            fault.since_s = now_s if is_steady else max(fault.since_s, fault.logged_s)
            fault.lasts, fault.is_logged, fault.causes = True, False, set()
        elif cause == fault.last_cause and cause not in fault.causes and len(fault.causes) < MOST_CAUSES:
            is_news = True
        fault.last_cause = cause
        if is_news:
            fault.causes.add(cause)
        is_due = is_news if fault.is_logged else now_s - fault.since_s >= fault.patience_s
        if not is_due:
            self._log.debug("%s%s", self._prefix, what)
            return is_news
        if not fault.is_logged:
            fault.patience_s = min(max(LASTS_S, 2 * fault.patience_s), FORGOTTEN_S)
        fault.is_logged, fault.logged_s = True, now_s
        self._log.warning("%s%s", self._prefix, what)
        return is_news

    def end(self, kind: str, what: str = "", now_s: float | None = None) -> None:
        """Note that a fault is over, if it lasted; `what`, if given, is logged with how long that was."""
        now_s = time.monotonic() if now_s is None else now_s
        fault = self._faults.get(kind)
        if fault is None or not fault.lasts:
            return
        fault.lasts, fault.ended_s = False, now_s
        if what:
            level = logging.INFO if fault.is_logged else logging.DEBUG
            self._log.log(level, "%s%s (after %.1f s)", self._prefix, what, now_s - fault.since_s)
