"""Single keys from the terminal, without Enter and without an echo."""

import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

POLL_S = 0.1


@contextmanager
def listening(on_key: Callable[[str], None]) -> Iterator[None]:
    """Call `on_key` from a thread of its own for each key, and restore the terminal at the end.

    Without a terminal, or in the background, where changing the terminal would stop the program, it does
    nothing.
    """
    if not sys.stdin.isatty() or _is_in_background(sys.stdin.fileno()):
        yield
        return
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    ended = threading.Event()
    reader = threading.Thread(target=_read, args=(fd, on_key, ended), name="touchd-keys", daemon=True)
    # Not raw: Ctrl-C still ends the program.
    tty.setcbreak(fd)
    reader.start()
    try:
        yield
    finally:
        ended.set()
        # Otherwise it could take a key that is meant for the next question.
        reader.join()
        with suppress(termios.error, OSError):
            termios.tcsetattr(fd, termios.TCSADRAIN, before)


def _is_in_background(fd: int) -> bool:
    try:
        return os.tcgetpgrp(fd) != os.getpgrp()
    except OSError:
        # Not the terminal that controls this program, so changing it does not stop it.
        return False


def _read(fd: int, on_key: Callable[[str], None], ended: threading.Event) -> None:
    with suppress(OSError):
        while not ended.is_set():
            if not select.select([fd], [], [], POLL_S)[0] or ended.is_set():
                continue
            data = os.read(fd, 64)
            if not data:
                return
            # Arrow keys and pasted text arrive as several bytes at once.
            if len(data) == 1 and data.isascii():
                on_key(data.decode())
