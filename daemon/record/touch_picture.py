"""Saved touches in the terminal: as a list, or one with its mean pad, pressure over time and answers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.columns import Columns
from rich.console import Console, Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from touchd.daemon.path.events import UNCERTAIN, Prediction
from touchd.daemon.sinks.touch_store import KeptFrames, KeptTouch
from touchd.daemon.sinks.touches import ReportedTouch
from touchd.daemon.view.pad_picture import as_text, level_of, pad_picture
from touchd.daemon.view.palette import palette_for
from touchd.drivers.errors import one_line
from touchd.drivers.frame import FRAME_RATE_HZ

WIDTH = 80
PAD_SCALE = 2
# Including the border.
PAD_WIDTH = 8 * PAD_SCALE + 2
CHART_WIDTH, CHART_HEIGHT = WIDTH - 4, 5
MOST_ANSWERS = 8
# Do not scale noise up to look like a touch.
LEAST_SCALE_COUNTS = 20.0
UNKNOWN = "?"
COLUMNS = {
    "began (UTC)": 14,
    "touch": 5,
    "length": 6,
    "early": 13,
    "revised": 13,
    "later": 13,
    "answer": 9,
}


@dataclass(frozen=True)
class Offered:
    """A saved touch and what the journal reported of it, None if the journal no longer holds it."""

    kept: KeptTouch
    reported: ReportedTouch | None

    @property
    def answers(self) -> Sequence[Prediction]:
        return self.reported.predictions if self.reported else ()

    @property
    def answer(self) -> str:
        """The gesture that the touch ended with, printable."""
        return one_line(self.reported.ended.gesture) if self.reported and self.reported.ended else UNKNOWN

    @property
    def length_s(self) -> str:
        """The time from first to last contact."""
        if self.reported is None or self.reported.ended is None:
            return UNKNOWN
        return f"{self.reported.ended.frames / FRAME_RATE_HZ:.1f} s"


def list_touches(offered: Sequence[Offered]) -> Table:
    """Return a table of touches: time, number, length, answers by stage, final gesture."""
    table = Table(box=None, padding=(0, 1, 0, 0), width=WIDTH, header_style="dim")
    for name, width in COLUMNS.items():
        table.add_column(name, width=width, no_wrap=True, overflow="ellipsis")
    for touch in offered:
        table.add_row(
            f"{touch.kept.time[5:10]} {touch.kept.time[11:19]}",
            str(touch.kept.number),
            touch.length_s,
            *_answers_in_columns(touch.answers),
            Text(touch.answer, "bold"),
        )
    return table


def draw(offered: Offered, frames: KeptFrames, title: str, console: Console) -> Group:
    """Return a touch drawn on 20 lines of 80 characters."""
    rise = rise_above_rest(frames)
    mean = rise.mean(axis=0)
    lines = pad_picture(level_of(mean, max(float(mean.max()), 1.0)), PAD_SCALE, palette_for(console))
    pad = Panel(as_text(lines), title=f"mean, 0 to {max(mean.max(), 1.0):.0f}", width=PAD_WIDTH, padding=0)
    answers = Panel(_answers(offered), title=title, width=WIDTH - PAD_WIDTH, height=10)
    clock_s = (frames.touch.sensor_ms - frames.touch.sensor_ms[0]) / 1000
    chart = Panel(_chart(rise.sum(axis=(1, 2)), clock_s, offered), width=WIDTH, title="pressure over time")
    return Group(Columns([pad, answers], padding=0, expand=False), chart)


def rise_above_rest(frames: KeptFrames) -> NDArray[np.float64]:
    """Return (T, 8, 8) counts above rest; the least reading of a taxel stands in for an unknown rest."""
    counts = frames.touch.counts.astype(np.float64)
    rest = np.median(frames.before.counts, axis=0) if frames.before is not None else counts.min(axis=0)
    rise: NDArray[np.float64] = np.maximum(counts - rest, 0.0)
    return rise


def _answers_in_columns(answers: Sequence[Prediction]) -> list[str]:
    """Return the early answer, the revised one, and the last one after these."""
    columns = {"early": "", "revised": "", "later": ""}
    for answer in answers:
        column = answer.stage if answer.stage in columns else "later"
        columns[column] = _in_words(answer)
    return list(columns.values())


def _answers(offered: Offered) -> Text:
    """Return the last answers to a touch, a line each."""
    if offered.reported is None:
        return Text("no longer in the journal", "dim")
    lines = [
        Text(
            f"{answer.stage:<9} {answer.elapsed_s:5.1f} s  {_in_words(answer):<15}",
            "bold" if answer.told else "",
        ).append("  told" if answer.told else "", "green")
        for answer in offered.answers[-MOST_ANSWERS:]
    ]
    return Text("\n").join(lines)


def _in_words(answer: Prediction) -> str:
    return UNCERTAIN if answer.gesture == UNCERTAIN else f"{one_line(answer.gesture)} {answer.confidence:.0%}"


def _chart(load: NDArray[np.float64], clock_s: NDArray[np.float64], offered: Offered) -> Text:
    """Return (T,) counts over (T,) seconds as columns of #, with answers marked below."""
    end_s = float(clock_s[-1]) or 1.0
    places = np.minimum((clock_s / end_s * CHART_WIDTH).astype(np.int64), CHART_WIDTH - 1)
    highs = np.zeros(CHART_WIDTH)
    np.maximum.at(highs, places, load)
    # A short touch has fewer frames than columns.
    highs = np.interp(np.arange(CHART_WIDTH), np.unique(places), highs[np.unique(places)])
    filled = np.rint(highs / max(float(highs.max()), LEAST_SCALE_COUNTS) * CHART_HEIGHT)
    lines = [
        "".join("#" if column >= level else " " for column in filled) for level in range(CHART_HEIGHT, 0, -1)
    ]
    marks = [" "] * CHART_WIDTH
    for answer in offered.answers:
        marks[min(round(answer.elapsed_s / end_s * CHART_WIDTH), CHART_WIDTH - 1)] = "^"
    legend = "^ an answer"
    scale = f"0 s{legend:^{CHART_WIDTH - 6 - len(f'{end_s:.1f}')}}{end_s:.1f} s"
    return Text("\n".join([*lines, "".join(marks), scale]))
