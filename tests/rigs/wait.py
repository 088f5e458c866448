"""Waits for a condition."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
# Not a specification: the time that a very busy machine may take.
WITHIN_S = 100.0
# Of what waits for nobody, too; systemd kills the daemon when its end takes as long.
AT_ONCE_S = 5.0


def wait_for(what: Callable[[], T], within_s: float = WITHIN_S) -> T:
    """Wait until `what` returns something true; return that."""
    until_s = time.monotonic() + within_s
    while not (found := what()):
        assert time.monotonic() < until_s, "it did not come"
        time.sleep(0.01)
    return found
