"""Draws the last touches of a journal, one below the other, with their answers and lengths."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from touchd.daemon.plot.plot import (
    INK,
    PALE,
    QUIET_INK,
    PlotError,
    bare,
    colour_of,
    draw_answer,
    draw_lanes,
    new_figure,
)
from touchd.daemon.sinks.touches import ReportedTouch
from touchd.drivers.frame import FRAME_RATE_HZ

TOUCH_INCHES, TITLE_INCHES = 0.3, 1.3
# A touch's answers in the order in which they came; those between the third and the last are not shown.
COLUMNS = ("first", "second", "third", "last")


def draw(touches: Sequence[ReportedTouch], title: str) -> Figure:
    """Draw touches, the oldest at the top; raises PlotError if there are none."""
    if not touches:
        raise PlotError(f"{title}: holds no touch yet")
    gestures = sorted({answer.gesture for touch in touches for answer in touch.predictions})
    height = TITLE_INCHES + TOUCH_INCHES * len(touches)
    figure = new_figure(height, f"{title}: the last touches ({len(touches)})")
    answers, lengths = figure.subplots(1, 2, sharey=True, width_ratios=[2.6, 1.0])
    _draw_answers(answers, touches, gestures)
    _draw_lengths(lengths, touches, gestures)
    # The oldest at the top; both plots share this axis.
    answers.set_ylim(len(touches) - 0.4, -0.6)
    return figure


def _draw_answers(axes: Axes, touches: Sequence[ReportedTouch], gestures: Sequence[str]) -> None:
    for row, touch in enumerate(touches):
        shown = touch.predictions[: len(COLUMNS) - 1] + touch.predictions[len(COLUMNS) - 1 :][-1:]
        for column, answer in enumerate(shown):
            when = f", {answer.elapsed_s:.3g} s"
            draw_answer(axes, column, row, answer, gestures, when=when)
    axes.set_xlim(-0.15, len(COLUMNS) - 0.2)
    axes.set_xticks(range(len(COLUMNS)), COLUMNS, ha="left")
    all_began = [touch.began for touch in touches]
    several = len({began.pad for began in all_began}) > 1
    names = [
        f"{began.time[:10]} {began.time[11:19]}   {f'{began.pad}, ' if several else ''}touch {began.touch}"
        for began in all_began
    ]
    axes.set_yticks(range(len(touches)), names)
    axes.set_xlabel("answers; filled: sent to the robot", fontsize=8, color=QUIET_INK)
    draw_lanes(axes)


def _draw_lengths(axes: Axes, touches: Sequence[ReportedTouch], gestures: Sequence[str]) -> None:
    for row, touch in enumerate(touches):
        told, colour = "not over", PALE
        length_s = max((answer.elapsed_s for answer in touch.predictions), default=0.0)
        if touch.ended is not None:
            told, length_s = touch.ended.gesture, touch.ended.frames / FRAME_RATE_HZ
            colour = colour_of(told, gestures)
        axes.barh(row, length_s, height=0.55, color=colour, alpha=0.6)
        axes.annotate(
            told, (0, row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8, color=INK
        )
    axes.set_xlabel("answer at the end, and length in seconds", fontsize=8, color=QUIET_INK)
    bare(axes, "left", "bottom")
    axes.tick_params(axis="y", length=0, labelleft=False)
