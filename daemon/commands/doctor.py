"""`touchd doctor`: checks pad, model and robot, and says what to do."""

import argparse
from functools import partial

from rich.console import Console
from rich.table import Table
from rich.text import Text

from touchd.daemon.commands.settings import add_settings, settings_of
from touchd.daemon.doctor.check import Check, Verdict
from touchd.daemon.doctor.examine import examine
from touchd.daemon.doctor.hand import add_grid, can_ask
from touchd.daemon.view.terminal import text_width
from touchd.drivers.errors import within

VERDICT_WIDTH, NAME_WIDTH = 11, 11
ADVICE_AT = VERDICT_WIDTH + NAME_WIDTH + 2
STYLES: dict[Verdict, str] = {"ok": "green", "warning": "yellow", "to do": "bold red", "not checked": "dim"}
DESCRIPTION = (
    "Checks the pad, the model and the robot, and says what to do. Leave the "
    "pad alone until it asks for a hand, which it does in a terminal. Exit code 0: nothing to do; "
    "1: something to do; 2: wrong options."
)


def add_options(parser: argparse.ArgumentParser) -> None:
    add_settings(parser)
    add_grid(parser)
    listens = "how long to listen to the pad (%(default)g)"
    parser.add_argument("--seconds", type=within(float, 1.0, 600.0), default=8.0, help=listens)


def main(options: argparse.Namespace) -> int:
    """Show a line for each check; returns 0 when there is nothing to do, else 1."""
    settings = settings_of(options).settings
    talk = Console(stderr=True, width=text_width(), highlight=False)
    console = Console(width=text_width(), highlight=False)
    say = partial(talk.print, style="cyan")
    to_do = 0
    for check in examine(settings, options.seconds, say, talk if can_ask() else None, options.grid):
        _show(console, check)
        to_do += check.verdict == "to do"
    console.print(f"{to_do} to do" if to_do else "nothing to do", style="bold")
    return int(to_do > 0)


def _show(console: Console, check: Check) -> None:
    # A line for the configuration, which must not be wrapped.
    is_to_paste = "format: " in check.advice
    line = Table.grid(padding=(0, 1, 0, 0))
    line.add_column(width=VERDICT_WIDTH)
    line.add_column(width=NAME_WIDTH)
    line.add_column(width=text_width() - VERDICT_WIDTH - NAME_WIDTH - 3, overflow="fold")
    line.add_row(Text(check.verdict, STYLES[check.verdict]), check.name, Text(check.found))
    if check.advice and not is_to_paste:
        line.add_row("", "", Text(f"-> {check.advice}", "bold"))
    console.print(line)
    if is_to_paste:
        console.print(Text(f"{' ' * ADVICE_AT}-> {check.advice}", "bold"), soft_wrap=True)
