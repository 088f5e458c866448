"""Questions at the terminal, answered by a line each."""

import sys
import termios
from collections.abc import Collection

from rich.console import Console


class Stopped(Exception):  # noqa: N818 - says what happened; it is handled, never shown as an error
    """The person stopped, or standard input ended."""


def ask(console: Console, question: str, answers: Collection[str]) -> str:
    """Return one of the answers, "" for Enter alone; raises Stopped on q or the end of input."""
    while True:
        answer = ask_line(console, question).lower()
        if answer == "q":
            raise Stopped
        if answer in answers:
            return answer
        named = ", ".join(answer or "Enter" for answer in (*answers, "q"))
        console.print(f"  {answer!r} is none of {named}", style="yellow")


def ask_line(console: Console, question: str) -> str:
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
