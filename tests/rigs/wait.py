"""Waits for a condition."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
# Not requirements: what a busy machine may need, for a condition and for a whole program.
SOON_S = 10.0
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
