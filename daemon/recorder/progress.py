"""The pad and the progress of a recording in the terminal, while it is made."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from touchd.daemon.terminal.big_words import big
from touchd.daemon.terminal.pad_picture import as_text, level_of, pad_picture
from touchd.daemon.terminal.palette import palette_for
from touchd.drivers.frame import COLUMNS, ROWS, Counts

REFRESH_HZ = 12
PAD_SCALE = 2
WIDTH = 56
GAP = 2
# How far noise rises above the least reading of a taxel, in counts.
NOISE_COUNTS = 6.0

# Shows the current step, how many seconds of how many have passed, and the pad's counts.
Show: TypeAlias = Callable[[str, float, float, Counts], None]


@contextmanager
def progress(console: Console) -> Iterator[Show]:
    """Draw what is shown until the end, then remove it; draws nothing where there is no terminal."""
    palette = palette_for(console)
    rest = np.full((ROWS, COLUMNS), np.inf)
    shown = ("", 0.0, 1.0, np.zeros((ROWS, COLUMNS)))

    def show(step: str, elapsed_s: float, length_s: float, pressure: Counts) -> None:
        nonlocal shown
        np.minimum(rest, pressure, out=rest)
        shown = step, elapsed_s, length_s, np.maximum(pressure - rest - NOISE_COUNTS, 0.0)

    def draw() -> Table:
        step, elapsed_s, length_s, pressure = shown
        width = min(WIDTH, console.width - COLUMNS * PAD_SCALE - GAP)
        words = [Text(line, style="bold") for line in big(step, width, False)]
        left = Text(f"{step}, {math.ceil(length_s - elapsed_s)} s")
        bar = ProgressBar(total=length_s, completed=elapsed_s, width=width)
        grid = Table.grid(padding=(1, GAP))
        grid.add_row(
            as_text(pad_picture(level_of(pressure), PAD_SCALE, palette)), Group(*words, "", left, bar)
        )
        return grid

    with Live(get_renderable=draw, console=console, transient=True, refresh_per_second=REFRESH_HZ):
        yield show
