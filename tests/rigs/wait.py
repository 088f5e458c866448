"""Waits for a condition, and retries timing tests."""

import functools
import time
from collections.abc import Callable
from contextlib import suppress
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
# Not requirements: what a busy machine may need, for a condition and for a whole program.
SOON_S = 60.0
WITHIN_S = 100.0
# The same for stopping, after which systemd would kill the daemon.
AT_ONCE_S = 5.0
LONGEST_PAUSE_S = 0.05


def wait_for(what: Callable[[], T], within_s: float = SOON_S) -> T:
    """Wait until `what` returns something true; return that."""
    until_s = time.monotonic() + within_s
    pause_s = 0.005
    while not (found := what()):
        assert time.monotonic() < until_s, "it did not come"
        time.sleep(pause_s)
        # Poll ever less often: reading a file or asking a browser takes processor time from the awaited work.
        pause_s = min(1.2 * pause_s, LONGEST_PAUSE_S)
    return found


def once_in_three(test: Callable[P, None]) -> Callable[P, None]:
    """Retry a timing test twice: another program may delay a reader once, but not three times running."""

    @functools.wraps(test)
    def repeated(*arguments: P.args, **named: P.kwargs) -> None:
        for _ in range(2):
            with suppress(AssertionError):
                return test(*arguments, **named)
        test(*arguments, **named)

    return repeated
