"""Questions at the terminal, answered by a line each."""

import sys
import termios
from collections.abc import Collection

from rich.console import Console

from touchd.daemon.recorder.session import NAME_RULE, Setting, is_name

USUAL = Setting()


class Stopped(Exception):  # noqa: N818 - says what happened; it is handled, never shown as an error
    """The person stopped, or standard input ended."""


def ask(console: Console, question: str, answers: Collection[str]) -> str:
    """Return one of the answers, "" for Enter alone; raises Stopped on q or the end of input."""
    while True:
        answer = _line(console, question).lower()
        if answer == "q":
            raise Stopped
        if answer in answers:
            return answer
        named = ", ".join(answer or "Enter" for answer in (*answers, "q"))
        console.print(f"  {answer!r} is none of {named}", style="yellow")


def ask_name(console: Console, question: str, default: str = "") -> str:
    """Return a name for a participant, a substrate or a cover; raises Stopped, as `ask` does."""
    hint = f" [{default}]" if default else ""
    while True:
        answer = _line(console, f"{question}{hint} ") or default
        if answer == "q":
            raise Stopped
        if is_name(answer):
            return answer
        console.print(f"  {answer!r}: {NAME_RULE}" if answer else f"  {NAME_RULE}", style="yellow")


def ask_setting(console: Console, given: object, usual: Setting = USUAL, past: bool = False) -> Setting:
    """Return who touches what: as the options say, asking for what they leave open; raises Stopped."""
    touches, is_ = ("touched", "was") if past else ("touches", "is")
    questions = (f"Who {touches} the pad?", f"What {is_} under the pad?", f"What {is_} over the pad?")
    options = [getattr(given, name, None) for name in Setting._fields]
    asked = zip(options, questions, usual, strict=True)
    return Setting(*(option or ask_name(console, question, default) for option, question, default in asked))


def _line(console: Console, question: str) -> str:
    # Discard what was typed before the question appeared.
    if sys.stdin.isatty():
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
    console.print(question, end="")
    line = sys.stdin.readline()
    if not line:
        console.print()
        raise Stopped
    return line.strip()
