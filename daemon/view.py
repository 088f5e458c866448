"""The terminal view: the pad as it is pressed, what is made of it and what happened, in 80x24 characters."""

from __future__ import annotations

import logging
import threading
from collections import deque
from types import TracebackType

import numpy as np
from rich.color import Color
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.style import Style
from rich.table import Table
from rich.text import Text

from daemon.describe import describe
from daemon.events import Event, Prediction, SensorEvent, TouchBegan, TouchEnded
from drivers.frame import COLUMNS, MAX_COUNT, ROWS, Counts

REFRESH_HZ = 12
WIDTH = 80
HISTORY = 11
TAXEL_WIDTH = 4
PAD_WIDTH = COLUMNS * TAXEL_WIDTH + 2
BAR_WIDTH = 22
# Seen where a terminal has no colours.
SHADES = " .:-=+*#%@"


class View:
    """A sink of events that draws them; also takes frames and notes. Safe to use from several threads.

    title: what is shown, one line. console: where, the terminal on standard output when left out.
    """

    name = "view"
    dropped = 0

    def __init__(self, title: str, console: Console | None = None) -> None:
        self._title = title
        self._lock = threading.Lock()
        self._pressure: Counts = np.zeros((ROWS, COLUMNS), dtype=np.uint16)
        self._touch: int | None = None
        self._answer: Prediction | None = None
        self._pad = "waiting for the pad"
        self._history: deque[tuple[str, str]] = deque(maxlen=HISTORY)
        self._live = Live(
            console=console, get_renderable=self.render, refresh_per_second=REFRESH_HZ, redirect_stdout=False
        )

    def show_frame(self, pressure: Counts) -> None:
        """Show a frame, (8, 8) counts, at the next refresh."""
        self._pressure = pressure

    def note(self, text: str, style: str = "") -> None:
        """Add a line to what happened."""
        with self._lock:
            self._history.append((text, style))

    def put(self, event: Event) -> None:
        """Show an event at the next refresh."""
        with self._lock:
            match event:
                case TouchBegan():
                    self._touch, self._answer = event.touch, None
                case Prediction():
                    self._answer = event
                case TouchEnded():
                    self._touch = None
                case SensorEvent():
                    self._pad = f"pad {event.state}"
        self.note(describe(event), "bold" if isinstance(event, Prediction) and event.told else "dim")

    def stop(self, timeout_s: float = 0.0) -> None:
        """Draw once more and leave the terminal as it was; never waits."""
        self._live.stop()

    def __enter__(self) -> View:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def render(self) -> Group:
        """Return the whole picture, 23 lines of 80 characters."""
        with self._lock:
            top = Table.grid(padding=0)
            top.add_row(self._draw_pad(), self._draw_answer())
            line_break = Text("\n", no_wrap=True, overflow="ellipsis")
            history = line_break.join(Text(text, style) for text, style in self._history)
            return Group(
                top,
                Panel(history, title=self._title, width=WIDTH, height=HISTORY + 2),
            )

    def _draw_pad(self) -> Panel:
        # The root lifts light touches, which would else be lost beside a press.
        levels = np.sqrt(np.minimum(self._pressure, MAX_COUNT) / MAX_COUNT)
        lines = [Text().join(_taxel(float(level)) for level in row) for row in levels]
        return Panel(Text("\n").join(lines), title=self._pad, width=PAD_WIDTH, padding=0)

    def _draw_answer(self) -> Panel:
        answer = self._answer
        rows: list[Text] = []
        if answer is not None:
            for label, probability in answer.probabilities.items():
                style = "bold green" if label == answer.gesture else ""
                bar = "#" * round(probability * BAR_WIDTH)
                rows.append(Text(f"{label:<9} {bar:<{BAR_WIDTH}} {probability:4.0%}", style))
            rows.append(Text(f"{answer.stage}, after {answer.elapsed_s:.1f} s", "dim"))
        title = f"touch {self._touch}" if self._touch is not None else "nothing touches"
        return Panel(Text("\n").join(rows), title=title, width=WIDTH - PAD_WIDTH, height=ROWS + 2)


class ViewHandler(logging.Handler):
    """Shows log lines in a view, where on standard error they would tear it."""

    def __init__(self, view: View) -> None:
        super().__init__()
        self._view = view

    def emit(self, record: logging.LogRecord) -> None:
        """Show one line."""
        self._view.note(record.getMessage(), "red" if record.levelno >= logging.WARNING else "dim")


def _taxel(level: float) -> Text:
    """Return a taxel pressed at `level` (0 to 1): from dark through red and yellow to white."""
    shade = SHADES[min(int(level * len(SHADES)), len(SHADES) - 1)]
    red, green, blue = (round(255 * min(max(3 * level - step, 0.0), 1.0)) for step in range(3))
    color = Color.from_rgb(max(red, 40), max(green, 40), max(blue, 60))
    return Text(shade * TAXEL_WIDTH, Style(color=color, bgcolor=color))
