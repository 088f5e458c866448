"""The front as a picture: error against the time of one answer, a panel each for 1, 1.5 and 2.67 s."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from model.quantize import FLOAT32
from model.study.front_rows import PRINTED, Row, front, printed_error, rows
from model.study.networks import INT8, PAPER_BLOCKS, SHIPPED
from model.study.results import Results

PANELS = {"after 1 s": (54,), "after 1.5 s": (72, 81), "after 2.67 s": (144,)}
OURS = "#1f5fa8"
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
        axes.set(title=title, xlabel="p50 of one answer, ms (one thread, ONNX Runtime)", xscale="log")
        axes.grid(True, which="both", linewidth=0.3, color="0.85")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panels[0].set_ylabel("macro error on the test participants, %")
    handles = {
        label: handle
        for axes in panels
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _panel(axes: Axes, together: Sequence[Row]) -> None:
    best = front(together)
    axes.step(
        [row.p50_ms for row in best],
        [_percent(row) for row in best],
        where="post",
        color="0.6",
        linewidth=5,
        alpha=0.45,
        label="the front: no network is both faster and better",
    )
    _draw_ours(axes, together)
    for family in PAPER:
        _draw_papers(axes, family, [row for row in together if row.family == family])


def _draw_ours(axes: Axes, together: Sequence[Row]) -> None:
    for arithmetic, fill in ((FLOAT32, OURS), (INT8, "white")):
        sizes = [row for row in together if (row.family, row.arithmetic) == ("touchd", arithmetic)]
        times, errors = [row.p50_ms for row in sizes], [_percent(row) for row in sizes]
        style = "-" if arithmetic == FLOAT32 else ":"
        axes.plot(
            times,
            errors,
            style,
            color=OURS,
            marker="o",
            markersize=7,
            mfc=fill,
            label=f"touchd, {arithmetic}",
        )
        if arithmetic == FLOAT32:
            for row in sizes:
                axes.annotate(
                    f"{row.width}",
                    (row.p50_ms, _percent(row)),
                    (0, 8),
                    textcoords="offset points",
                    ha="center",
                    color=OURS,
                    fontsize=9,
                )
    (shipped,) = (row for row in together if (row.name, row.arithmetic) == (SHIPPED, FLOAT32))
    axes.plot(
        [shipped.p50_ms],
        [_percent(shipped)],
        "*",
        color="gold",
        mec=OURS,
        markersize=18,
        zorder=5,
        linestyle="",
        label="the shipped model",
    )


def _draw_papers(axes: Axes, family: str, theirs: Sequence[Row]) -> None:
    colour = PAPER[family]
    blocks = [row for row in theirs if row.error and row.blocks != PAPER_BLOCKS]
    trained = [row for row in theirs if row.error and row.error.source != PRINTED]
    _points(axes, blocks, ".", colour, f"the paper's, {CODE[family]}, 1 to 8 blocks")
    _points(axes, trained, "s", colour, f"the paper's, {CODE[family]}, trained here")
    for row in theirs:
        printed = printed_error(row.frames, row.blocks)
        if printed and row.blocks == PAPER_BLOCKS and row.arithmetic == FLOAT32:
            label = f"the paper's figure, {CODE[family]} (epoch chosen on test)"
            axes.plot(
                [row.p50_ms],
                [100 * printed.share],
                "X",
                color=colour,
                markersize=11,
                label=label,
                linestyle="",
            )


def _points(axes: Axes, shown: Sequence[Row], marker: str, colour: str, label: str) -> None:
    if shown:
        axes.plot(
            [row.p50_ms for row in shown], [_percent(row) for row in shown], marker, color=colour, label=label
        )


def _percent(row: Row) -> float:
    assert row.error is not None
    return 100 * row.error.share
