"""Who touches what: their names, on the command line and asked for."""

import argparse
import re
from typing import NamedTuple

from rich.console import Console

from touchd.daemon.view.terminal import Stopped, ask_line

# Names become parts of file names, separated by "_", and cells of CSV files.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9-]{0,31}")
NAME_RULE = "a name has letters (a to z), digits and - only, 32 at most"


class Setting(NamedTuple):
    """Who touches what. substrate: under the pad. cover: over it."""

    participant: str = ""
    substrate: str = "none"
    cover: str = "none"


def is_name(text: str) -> bool:
    """Whether a text can name a participant, a substrate, a cover or a gesture."""
    return NAME.fullmatch(text) is not None


def name(text: str) -> str:
    """Check a name from the command line; for argparse."""
    if not is_name(text):
        raise argparse.ArgumentTypeError(f"invalid name {text!r}: {NAME_RULE}")
    return text


def ask_name(console: Console, question: str, default: str = "") -> str:
    """Return a name for a participant, a substrate or a cover; raises Stopped, as `ask` does."""
    hint = f" [{default}]" if default else ""
    while True:
        answer = ask_line(console, f"{question}{hint} ") or default
        if answer == "q":
            raise Stopped
        if is_name(answer):
            return answer
        console.print(f"  {answer!r}: {NAME_RULE}" if answer else f"  {NAME_RULE}", style="yellow")


def ask_setting(console: Console, given: object) -> Setting:
    """Return who touches what: as the options say, asking for what they leave open; raises Stopped."""
    questions = ("Who touches the pad?", "What is under the pad?", "What is over the pad?")
    options = [getattr(given, name, None) for name in Setting._fields]
    asked = zip(options, questions, Setting(), strict=True)
    return Setting(*(option or ask_name(console, question, default) for option, question, default in asked))
