"""The terminal: questions answered by a line each, single keys, and the width of text."""

import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from shutil import get_terminal_size
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # The daemon reads keys and loads nothing that draws unless it is shown.
    from rich.console import Console

MOST_WIDTH = 80
POLL_S = 0.1


class Stopped(Exception):  # noqa: N818 - says what happened; it is handled, never shown as an error
    """The person stopped, or standard input ended."""


def text_width() -> int:
    """Return the number of characters in a line: the terminal's, but at most MOST_WIDTH."""
    return min(MOST_WIDTH, get_terminal_size().columns)


def ask(console: "Console", question: str, answers: Collection[str]) -> str:
    """Return one of the answers, "" for Enter alone; raises Stopped on q or the end of input."""
    while True:
        answer = ask_line(console, question).lower()
        if answer == "q":
            raise Stopped
        if answer in answers:
            return answer
        named = ", ".join(answer or "Enter" for answer in (*answers, "q"))
        console.print(f"  {answer!r} is none of {named}", style="yellow")


def ask_line(console: "Console", question: str) -> str:
    """Return the line that the person types; raises Stopped at the end of input."""
    # Discard what was typed before the question appeared.
    if sys.stdin.isatty():
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    console.print(question, end="")
    line = sys.stdin.readline()
    if not line:
        console.print()
        raise Stopped
    return line.strip()


@contextmanager
def listening(on_key: Callable[[str], None]) -> Iterator[None]:
    """Call `on_key` for each key, from another thread and without an echo; restore the terminal at the end.

    Does nothing without a terminal, or in the background, where changing the terminal would stop the program.
    """
    if not sys.stdin.isatty() or _is_in_background(sys.stdin.fileno()):
        yield
        return
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    ended = threading.Event()
    reader = threading.Thread(target=_read, args=(fd, on_key, ended), name="touchd-keys", daemon=True)
    # Not raw: Ctrl-C still ends the program. Ctrl-S would stop the output, and the end waits for that.
    tty.setcbreak(fd)
    flags, *others = termios.tcgetattr(fd)
    termios.tcsetattr(fd, termios.TCSANOW, [flags & ~termios.IXON, *others])
    reader.start()
    try:
        yield
    finally:
        ended.set()
        # The thread must not take a key that is meant for the next question.
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
            if not (data := os.read(fd, 64)):
                return
            # Arrow keys and pasted text arrive as several bytes at once.
            if len(data) == 1 and data.isascii():
                on_key(data.decode())
