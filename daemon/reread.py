"""SIGHUP: the configuration is read again while the daemon runs on, and a wrong one changes nothing."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from daemon.config import Settings
from drivers.errors import TouchdError

log = logging.getLogger(__name__)

STOP_S = 0.2


@contextmanager
def rereading(
    asked: threading.Event, read: Callable[[], Settings], change: Callable[[Settings], Sequence[str]]
) -> Iterator[None]:
    """Whenever `asked` is set, read the settings again and change to them, in a thread of its own.

    read: raises TouchdError when the settings are wrong. change: returns the names of what changed; raises
    TouchdError, with nothing changed, when they cannot be used.
    """
    ending = threading.Event()

    def wait() -> None:
        while True:
            asked.wait()
            asked.clear()
            if ending.is_set():
                return
            _reread(read, change)

    thread = threading.Thread(target=wait, name="touchd-reread", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        asked.set()
        thread.join(STOP_S)


def _reread(read: Callable[[], Settings], change: Callable[[Settings], Sequence[str]]) -> None:
    try:
        changed = change(read())
    except TouchdError as error:
        log.warning("the new configuration is refused and the old one stays: %s", error)
    except Exception:
        log.exception("the configuration could not be read again; the old one stays")
    else:
        log.info("configuration read again; changed: %s", ", ".join(changed) or "nothing")
