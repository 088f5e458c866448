"""The time line of a touch: pressure, the marks at which answers are due, and the answers."""

from collections.abc import Sequence
from dataclasses import dataclass

from rich.segment import Segment
from rich.style import Style

from touchd.daemon.view.pad_picture import DrawnLine
from touchd.daemon.view.palette import Palette

SHORTEST_S = 4.0
AFTER_FINAL = 1.5
# Sum of counts at full height, unless the touch is firmer.
LIGHT_LOAD = 600.0
# From this width on, every mark shows its unit.
ROOMY = 40
STEPS = " ▁▂▃▄▅▆▇█"

Cells = list[list[tuple[str, Style]]]


@dataclass(frozen=True)
class Flag:
    """An answer and its time."""

    at_s: float
    text: str
    changed: bool


def time_line(
    trace: Sequence[tuple[float, float]],
    marks_s: Sequence[float],
    flags: Sequence[Flag],
    size: tuple[int, int],
    palette: Palette,
) -> list[DrawnLine]:
    """Return the time line in (width, height) characters; the last line labels the marks.

    trace: (seconds since the touch began, sum of counts).
    """
    width, height = size
    end_s = max(SHORTEST_S, marks_s[-1] * AFTER_FINAL)
    rows = height - 1
    cells: Cells = [[(" ", palette.paper)] * width for _ in range(rows)]
    _draw_trace(cells, trace, end_s, palette)
    reached_s = trace[-1][0] if trace else 0.0
    for mark_s in marks_s:
        style = palette.muted if reached_s >= mark_s else palette.rail
        for row in cells:
            row[_column(mark_s, end_s, width)] = ("│" if reached_s >= mark_s else "┊", style)
    _draw_flags(cells, flags, end_s, palette)
    return [[Segment(text, style) for text, style in row] for row in cells] + [
        _labels(marks_s, end_s, width, palette)
    ]


def _column(at_s: float, end_s: float, width: int) -> int:
    return min(int(at_s / end_s * width), width - 1)


def _draw_trace(cells: Cells, trace: Sequence[tuple[float, float]], end_s: float, palette: Palette) -> None:
    rows, width = len(cells), len(cells[0])
    loads: dict[int, float] = {}
    for at_s, load in trace:
        if 0 <= at_s < end_s:
            column = _column(at_s, end_s, width)
            loads[column] = max(loads.get(column, 0.0), load)
    peak = max([LIGHT_LOAD, *loads.values()])
    for column, load in loads.items():
        # The square root makes light touches visible, as on the live page.
        eighths = round((load / peak) ** 0.5 * rows * 8)
        for row in range(rows):
            step = min(max(eighths - 8 * (rows - 1 - row), 0), 8)
            if step:
                cells[row][column] = (STEPS[step], palette.trace)


def _draw_flags(cells: Cells, flags: Sequence[Flag], end_s: float, palette: Palette) -> None:
    """Put each flag into the highest free row."""
    rows, width = len(cells), len(cells[0])
    taken: list[tuple[int, int, int]] = []
    for flag in flags:
        text = f" {flag.text} "[: width - 1]
        mark = _column(flag.at_s, end_s, width)
        # Without room to the right of the mark, the flag hangs to its left.
        is_left = mark + len(text) + 1 > width
        first = max(mark - len(text), 0) if is_left else mark
        last = first + len(text) + 1
        free = (
            row for row in range(rows) if not any(r == row and first < b and last > a for r, a, b in taken)
        )
        row = next(free, rows - 1)
        taken.append((row, first, last))
        style = palette.changed_flag if flag.changed else palette.accent_flag
        pole = style + Style(color=(palette.changed if flag.changed else palette.accent).color)
        cell = [(character, style) for character in text]
        cells[row][first:last] = [*cell, ("▐", pole)] if is_left else [("▌", pole), *cell]


def _labels(marks_s: Sequence[float], end_s: float, width: int, palette: Palette) -> DrawnLine:
    line = [" "] * width
    # The last label first: where there is room for one alone, it names the end.
    for mark_s in (marks_s[-1], *marks_s[:-1]):
        text = f"{mark_s:.3g} s" if width >= ROOMY or mark_s == marks_s[-1] else f"{mark_s:.3g}"
        start = min(max(_column(mark_s, end_s, width) - len(text) // 2, 0), width - len(text))
        if not "".join(line[max(start - 1, 0) : start + len(text) + 1]).strip():
            line[start : start + len(text)] = text
    return [Segment("".join(line), palette.muted)]
