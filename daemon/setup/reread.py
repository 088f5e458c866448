"""SIGHUP: the configuration is read again while the daemon runs on, and a wrong one changes nothing."""

import gc
import itertools
import logging
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from touchd.daemon.config import Settings
from touchd.drivers.errors import TouchdError

log = logging.getLogger(__name__)

STOP_S = 0.2
# More than a model takes to load: a Python that ends while ONNX Runtime loads one aborts.
SETTLE_S = 1.0
PATIENCE_S = 30.0
LOOK_S = 0.5


class Reloader:
    """Reads the settings again, each time in a thread of its own: one that hangs must not disable the next.

    read: returns the settings. use: goes on by them, and returns the names of those that changed. Both raise
    TouchdError when something is wrong.
    """

    def __init__(self, read: Callable[[], Settings], use: Callable[[Settings], list[str]]) -> None:
        self._read = read
        self._use = use
        self._numbers = itertools.count(1)
        self._latest = 0
        self._one_at_a_time = threading.Lock()

    def start(self) -> None:
        """Begin to read the settings again; returns at once."""
        self._latest = next(self._numbers)
        threading.Thread(target=self._reload, args=(self._latest,), name="touchd-reload", daemon=True).start()

    def end(self) -> None:
        """Wait for the reload under way, and begin no other."""
        self._latest = next(self._numbers)
        if self._one_at_a_time.acquire(timeout=SETTLE_S):
            self._one_at_a_time.release()

    def _reload(self, number: int) -> None:
        try:
            settings = self._read()
            until_s = time.monotonic() + PATIENCE_S
            while not self._one_at_a_time.acquire(timeout=LOOK_S):
                if number != self._latest:
                    return
                if time.monotonic() > until_s:
                    until_s = math.inf
                    log.warning(
                        "an earlier reload still waits for a touch to end, or for a file; this one comes next"
                    )
            try:
                if number == self._latest:
                    changed = ", ".join(self._use(settings))
                    # What was replaced holds megabytes in few objects; Python would come to it late.
                    gc.collect()
                    log.info("configuration read again; changed: %s", changed or "nothing")
            finally:
                self._one_at_a_time.release()
        except TouchdError as error:
            log.warning("the new configuration is refused and the old one stays: %s", error)
        except Exception:
            log.exception("the configuration could not be read again; the old one stays")


@contextmanager
def rereading(asked: threading.Event, reloader: Reloader) -> Iterator[None]:
    ending = threading.Event()

    def wait() -> None:
        while True:
            asked.wait()
            asked.clear()
            if ending.is_set():
                return
            reloader.start()

    thread = threading.Thread(target=wait, name="touchd-reread", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        asked.set()
        thread.join(STOP_S)
        reloader.end()
