"""Lanes for the answers of a touch: one for each mark, and one for what is answered later."""

from __future__ import annotations

from typing import TYPE_CHECKING

from daemon.events import Prediction
from daemon.plot.plot import PALE, bare

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LANES = ("early", "revised", "final", "later")


def lane_of(answer: Prediction) -> int:
    return LANES.index(answer.stage) if answer.stage in LANES else len(LANES) - 1


def draw_lanes(axes: Axes) -> None:
    """Draw a line for each tick, without a frame."""
    axes.grid(axis="y", color=PALE, linewidth=0.8)
    axes.set_axisbelow(True)
    bare(axes)
    axes.tick_params(length=0)
