"""The front as a picture: error against the time of one answer, a panel each for 1, 1.5 and 2.67 s."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from docs.studies.quantize import FLOAT32
from docs.studies.report.front_rows import PRINTED, Row, front, printed_error, rows
from docs.studies.report.networks import HUGHES, INT8, OURS, PAPER_BLOCKS
from docs.studies.report.results import Results

PANELS = {"after 1 s": (54,), "after 1.5 s": (72, 81), "after 2.67 s": (144,)}
BLUE = "#1f5fa8"
PAPER = {"public": "#c4611a", "printed": "#7a3f98"}
CODE = {"public": "as its code has it", "printed": "as printed"}


def draw(results: Results, path: Path) -> None:
    """Draw what has been measured; nothing where nothing has."""
    found = rows(results)
    if not found:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    figure, panels = plt.subplots(
        1, len(PANELS), figsize=(13, 5.4), layout="constrained", sharex=True, sharey=True
    )
    for axes, (title, lengths) in zip(panels, PANELS.items(), strict=True):
        _panel(axes, [row for row in found if row.frames in lengths])
        axes.set(title=title, xlabel="processor time of one answer, ms", xscale="log")
        axes.grid(True, which="both", linewidth=0.3, color="0.85")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panels[0].set_xlim(left=0.5 * min(row.processor_ms for row in found))
    panels[0].set_ylabel("macro error on the test participants, %")
    handles = {
        label: handle
        for axes in panels
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _panel(axes: Axes, together: Sequence[Row]) -> None:
    best = front(together)
    axes.step(
        [row.processor_ms for row in best],
        [_percent(row) for row in best],
        where="post",
        color="0.6",
        linewidth=5,
        alpha=0.45,
        label="the front: none is both faster and better",
    )
    _draw_ours(axes, together)
    challenge = [row for row in together if row.family == HUGHES and row.error]
    _points(axes, challenge, "the challenge's networks, Hughes et al.", "0.35", marker="D")
    for family in PAPER:
        _draw_papers(axes, family, [row for row in together if row.family == family])


def _draw_ours(axes: Axes, together: Sequence[Row]) -> None:
    for arithmetic, fill, line in ((FLOAT32, BLUE, "-"), (INT8, "white", ":")):
        sizes = [row for row in together if (row.family, row.arithmetic) == (OURS, arithmetic)]
        _points(axes, sizes, f"touchd {arithmetic}, by width", BLUE, marker="o", mfc=fill, linestyle=line)
    shipped = [row for row in together if row.shipped]
    for row in together:
        if row.family == OURS and row.arithmetic == FLOAT32:
            # The star of the shipped model would hide what stands to its left.
            offset, side = ((8, -4), "left") if row.width > shipped[0].width else ((-20, -4), "right")
            place = (row.processor_ms, _percent(row))
            axes.annotate(f"{row.width}", place, offset, textcoords="offset points", ha=side, color=BLUE)
    _points(axes, shipped, "the shipped model", "gold", marker="*", mec=BLUE, markersize=18, zorder=5)


def _draw_papers(axes: Axes, family: str, theirs: Sequence[Row]) -> None:
    colour, code = PAPER[family], CODE[family]
    named = [row for row in theirs if row.error]
    trained = [row for row in named if row.error and row.error.source != PRINTED]
    others = [row for row in named if row not in trained and row.blocks != PAPER_BLOCKS]
    _points(axes, others, f"its figures for other numbers of blocks, {code}", colour, marker=".")
    _points(axes, trained, f"the paper's network {code}, trained here", colour, marker="s")
    for row in theirs:
        printed = printed_error(row.frames, row.blocks)
        if printed and row.blocks == PAPER_BLOCKS and row.arithmetic == FLOAT32:
            label = f"the paper's figure, network {code}"
            place = ([row.processor_ms], [100 * printed.share])
            axes.plot(*place, marker="X", markersize=11, linestyle="", color=colour, label=label)


def _points(axes: Axes, shown: Sequence[Row], label: str, colour: str, **style: Any) -> None:
    if shown:
        times, errors = [row.processor_ms for row in shown], [_percent(row) for row in shown]
        axes.plot(times, errors, **{"linestyle": "", "markersize": 7, **style}, color=colour, label=label)


def _percent(row: Row) -> float:
    assert row.error is not None
    return 100 * row.error.share
