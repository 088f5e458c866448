"""Faults that come and go: how long to wait before another attempt, and how often to log one."""

import logging
import math
import random
import time
from collections import defaultdict
from dataclasses import dataclass, field

# Minimum interval between the warnings of a fault that comes and goes: 24 lines an hour at most.
AGAIN_S = 300.0
# Most causes reported for one fault while it lasts: they may contain a peer's text.
MOST_CAUSES = 8


class Backoff:
    """Pauses that double from the first to the cap, each shortened at random by up to half."""

    def __init__(self, first_s: float, cap_s: float) -> None:
        self._first_s, self._cap_s, self._next_s = first_s, cap_s, first_s

    def pause_s(self) -> float:
        """Return how long to wait now, in seconds."""
        pause_s = self._next_s
        self._next_s = min(2 * pause_s, self._cap_s)
        return pause_s * random.uniform(0.5, 1.0)

    def reset(self) -> None:
        self._next_s = self._first_s


@dataclass
class _Fault:
    """warned_s: time of the last warning, -inf before the first. causes: those reported since it began."""

    lasts: bool = False
    since_s: float = 0.0
    is_logged: bool = False
    warned_s: float = -math.inf
    causes: set[str] = field(default_factory=set)
    last_cause: str = ""
    total: int = 0


class FaultLog:
    """Logs a fault when it begins and when it ends, but no new warning within AGAIN_S of the last.

    A fault that comes back sooner is warned about once AGAIN_S has passed, if it still lasts. While a fault
    lasts, a new cause is warned about once it was reported twice in a row, as a single report may be passing.
    Everything else is logged at debug level.
    log: what to log to. prefix: begins every line. Times are `time.monotonic()`, by default the current one.
    """

    def __init__(self, log: logging.Logger, prefix: str = "") -> None:
        self._log, self._prefix = log, prefix
        self._faults: defaultdict[str, _Fault] = defaultdict(_Fault)

    def begin(self, kind: str, what: str, now_s: float | None = None, cause: str = "") -> bool:
        """Note that a fault has begun or still lasts; call it repeatedly while it lasts.

        Returns whether this is news: the fault has just begun, or has another cause.
        """
        now_s = time.monotonic() if now_s is None else now_s
        fault = self._faults[kind]
        is_news = not fault.lasts
        if is_news:
            fault.lasts, fault.since_s, fault.is_logged, fault.causes = True, now_s, False, set()
        elif cause == fault.last_cause and cause not in fault.causes:
            is_news = len(fault.causes) < MOST_CAUSES
        fault.last_cause = cause
        if is_news:
            fault.causes.add(cause)
        is_warning = is_news if fault.is_logged else now_s - fault.warned_s >= AGAIN_S
        if is_warning:
            fault.is_logged, fault.warned_s = True, now_s
        self._log.log(logging.WARNING if is_warning else logging.DEBUG, "%s%s", self._prefix, what)
        return is_news

    def count(self, kind: str, total: int, what: str, over: str) -> None:
        """Note how often something happened so far: the fault lasts while this rises from call to call."""
        fault = self._faults[kind]
        if total != fault.total:
            self.begin(kind, what)
        else:
            self.end(kind, over)
        fault.total = total

    def end(self, kind: str, what: str = "", now_s: float | None = None) -> bool:
        """Note that a fault is over, if it lasted; `what`, if given, is logged with how long that was.

        Returns whether that line is for users, as its warning was.
        """
        now_s = time.monotonic() if now_s is None else now_s
        fault = self._faults[kind]
        is_over, fault.lasts = fault.lasts and bool(what), False
        if is_over:
            level = logging.INFO if fault.is_logged else logging.DEBUG
            self._log.log(level, "%s%s (after %.1f s)", self._prefix, what, now_s - fault.since_s)
        return is_over and fault.is_logged
