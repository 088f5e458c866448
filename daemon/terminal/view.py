"""The terminal view: the pad as it is pressed, what is made of it and what happened, in 80x24 characters."""

from __future__ import annotations

import logging
import threading
from collections import deque
from types import TracebackType

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from daemon.events import Event, LivePrediction, Prediction, SensorEvent, TouchBegan, TouchEnded
from daemon.terminal.describe import describe
from daemon.terminal.pad_picture import PAD_WIDTH, pad_picture
from drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, ROWS, Counts

REFRESH_HZ = 12
WIDTH = 80
HISTORY = 11
BAR_WIDTH = 22
LABEL_WIDTH = 12
MOST_LABELS = ROWS - 1


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
        self._now: LivePrediction | None = None
        self._pad = "waiting for the pad"
        self._history: deque[tuple[str, str]] = deque(maxlen=HISTORY)
        self._live = Live(
            console=console, get_renderable=self.render, refresh_per_second=REFRESH_HZ, redirect_stdout=False
        )

    def show_frame(self, pressure: Counts) -> None:
        """Show a frame, (8, 8) counts, at the next refresh."""
        self._pressure = pressure

    def put_live(self, prediction: LivePrediction) -> None:
        """Show what the model makes of the touch at this moment, at the next refresh."""
        self._now = prediction

    def note(self, text: str, style: str = "") -> None:
        """Add a line to what happened."""
        with self._lock:
            self._history.append((text, style))

    def put(self, event: Event) -> None:
        """Show an event at the next refresh."""
        with self._lock:
            match event:
                case TouchBegan():
                    self._touch, self._answer, self._now = event.touch, None, None
                case Prediction():
                    self._answer, self._now = event, None
                case TouchEnded():
                    self._touch, self._now = None, None
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
        picture = pad_picture(self._pressure, MAX_COUNT)
        return Panel(picture, title=self._pad, width=PAD_WIDTH, padding=0)

    def _draw_answer(self) -> Panel:
        answer, now = self._answer, self._now
        shown = now or answer
        rows: list[Text] = []
        if shown is not None:
            # A lab's own model may know more gestures than there are lines for: the likeliest are shown.
            likeliest = sorted(shown.probabilities.values(), reverse=True)[:MOST_LABELS]
            for label, probability in shown.probabilities.items():
                if probability < likeliest[-1] or len(rows) == MOST_LABELS:
                    continue
                style = "bold green" if answer is not None and label == answer.gesture else ""
                bar = "#" * round(probability * BAR_WIDTH)
                name = f"{label[:LABEL_WIDTH]:<{LABEL_WIDTH}}"
                rows.append(Text(f"{name} {bar:<{BAR_WIDTH}} {probability:4.0%}", style))
        if now is not None:
            rows.append(Text(f"so far, after {now.frames / FRAME_RATE_HZ:.1f} s", "dim"))
        elif answer is not None:
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
