"""Shared by pictures of recordings and journals: colours, marks, lanes for answers, saving."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from touchd.daemon.path.events import UNCERTAIN, Prediction
from touchd.drivers.errors import TouchdError, os_errors_as
from touchd.drivers.frame import NO_TOUCH, OTHER

WIDTH_INCHES = 12.0
DOTS_PER_INCH = 130
FORMATS = (".png", ".svg", ".pdf")
# One for each stage at a mark, and one for those about touches that are over or go on.
LANES = ("early", "revised", "final", "released, later")
# Names may contain what matplotlib parses as a formula.
NO_FORMULA: Mapping[str, Any] = {"parse_math": False}
INK, QUIET_INK, PALE = "#222222", "#777777", "#e4e4e4"
# Okabe and Ito's palette for colour-blind people; OTHER_COLOURS are for a lab's own gestures.
COLOURS: Mapping[str, str] = {
    "constant": "#0072b2",
    "pat": "#e69f00",
    "rub": "#009e73",
    "scratch": "#d55e00",
    "stroke": "#cc79a7",
    "tickle": "#56b4e9",
    OTHER: "#000000",
    NO_TOUCH: "#9a9a9a",
    UNCERTAIN: "#9a9a9a",
}
MARK: Mapping[str, Any] = {"marker": "o", "markersize": 6, "markeredgewidth": 1.4, "zorder": 3}
BESIDE: Mapping[str, Any] = {"xytext": (6, 0), "textcoords": "offset points", "va": "center", "fontsize": 7.5}
OTHER_COLOURS = ("#6a4c93", "#8c564b", "#b5a800", "#3d405b")


class PlotError(TouchdError):
    """A picture cannot be made; the message says what to do."""


def colour_of(gesture: str, gestures: Iterable[str]) -> str:
    """Return the colour of a gesture. gestures: all those in the picture."""
    if gesture in COLOURS:
        return COLOURS[gesture]
    others = sorted(set(gestures) - COLOURS.keys())
    return OTHER_COLOURS[others.index(gesture) % len(OTHER_COLOURS)]


def new_figure(height_inches: float, title: str) -> Figure:
    figure = Figure(figsize=(WIDTH_INCHES, height_inches), layout="constrained", facecolor="white")
    figure.suptitle(title, fontsize=11, color=INK, **NO_FORMULA)
    return figure


def check_format(path: Path) -> None:
    """Raise PlotError if the suffix names no format of pictures."""
    if path.suffix not in FORMATS:
        raise PlotError(f"{path}: unknown format; end the name of -o with {', '.join(FORMATS)}")


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format that the suffix names; raises PlotError."""
    with os_errors_as(PlotError, f"{path}: cannot be written", "name another file with -o"):
        figure.savefig(path, dpi=DOTS_PER_INCH)


def draw_answer(
    axes: Axes,
    x: float,
    y: float,
    answer: Prediction,
    gestures: Iterable[str],
    *,
    wrong: bool = False,
    when: str = "",
) -> None:
    """Draw an answer, filled if it was sent to the robot, and `when` it came.

    gestures: all those in the picture.
    """
    colour = colour_of(answer.gesture, gestures)
    inside = colour if answer.told else "white"
    axes.plot([x], [y], markeredgecolor=colour, markerfacecolor=inside, clip_on=False, **MARK)
    words = f"{answer.gesture} {answer.confidence:.0%}" if answer.gesture != UNCERTAIN else UNCERTAIN
    ink, slant = ("#c00000", "italic") if wrong else (INK, "normal")
    axes.annotate(f"{words}{when}", (x, y), color=ink, fontstyle=slant, annotation_clip=False, **BESIDE)


def bare(axes: Axes, *keep: str) -> None:
    """Remove the frame around axes, except for the sides to keep."""
    for side, spine in axes.spines.items():
        spine.set_visible(side in keep)
        spine.set_color(QUIET_INK)
    axes.tick_params(colors=QUIET_INK, labelsize=8)


def lane_of(answer: Prediction) -> int:
    return LANES.index(answer.stage) if answer.stage in LANES else len(LANES) - 1


def draw_lanes(axes: Axes) -> None:
    """Draw a line at each tick and no frame."""
    axes.grid(axis="y", color=PALE, linewidth=0.8)
    axes.set_axisbelow(True)
    bare(axes)
    axes.tick_params(length=0)
