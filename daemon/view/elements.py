"""Parts of the view: the pad, words in large letters, the probabilities as bars, the time line of a touch."""

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.cells import cell_len, set_cell_size
from rich.color import blend_rgb, parse_rgb_hex
from rich.console import Console
from rich.style import Style
from rich.text import Text

from touchd.drivers.frame import COLUMNS

# The page's dark theme, on PAPER throughout. rich leaves the colours out where the terminal has none.
PAPER = Style.parse("on #0c0f13")
INK = Style.parse("#f3f5f8")
MUTED = Style.parse("#aab4c2")
FAINT = Style.parse("#5d6877")
ACCENT = Style.parse("#7cc4ff")
CHANGED = Style.parse("#ffb65c")
ROBOT = Style.parse("#9be7c4")
BAD = Style.parse("#ff9a9a")
RAIL = Style.parse("#2b323d")
TRACE = Style.parse("#2f5d80")
ACCENT_FLAG = Style.parse("#f3f5f8 on #17364f")
CHANGED_FLAG = Style.parse("#ffb65c on #3b2a12")
# As on the live page: colours follow the logarithm of pressure, from "light" to "firm" counts.
LIGHT_COUNTS = 4.0
FIRM_COUNTS = 250.0
HEAT = [parse_rgb_hex(colour) for colour in ("171c24", "42249a", "85248a", "d04361", "f9903f", "fdf4b5")]
SHADES = 64
COLOURS = [
    blend_rgb(HEAT[int(at)], HEAT[min(int(at) + 1, len(HEAT) - 1)], at % 1).hex
    for at in (np.arange(SHADES) / (SHADES - 1) * (len(HEAT) - 1)).tolist()
]
# For terminals without colours, from no pressure to firm.
CHARACTERS = " ·:-=+*#%@"
# The pixels of letters, row by row; a dot is empty.
FONT = {
    "ABCDEFGHIJKLMÄÖÜ- ": (
        ".#. ##. .## ##. ### ### .## #.# # ..# #..# #.. #...# #.# #.# #.# ... ..",
        "#.# #.# #.. #.# #.. #.. #.. #.# # ..# #.#. #.. ##.## .#. .#. ... ... ..",
        "### ##. #.. #.# ##. ##. #.# ### # ..# ##.. #.. #.#.# #.# #.# #.# ### ..",
        "#.# #.# #.. #.# #.. #.. #.# #.# # #.# #.#. #.. #...# ### #.# #.# ... ..",
        "#.# ##. .## ##. ### #.. .## #.# # .#. #..# ### #...# #.# .#. ### ... ..",
    ),
    "NOPQRSTUVWXYZ": (
        "#..# .#. ##. .##. ##. .## ### #.# #.# #...# #.# #.# ###",
        "##.# #.# #.# #..# #.# #.. .#. #.# #.# #...# #.# #.# ..#",
        "#.## #.# ##. #..# ##. .#. .#. #.# #.# #.#.# .#. .#. .#.",
        "#..# #.# #.. #.#. #.# ..# .#. #.# #.# ##.## #.# .#. #..",
        "#..# .#. #.. .#.# #.# ##. .#. ### .#. #...# #.# .#. ###",
    ),
}
LETTERS = {
    letter: pixels
    for letters, rows in FONT.items()
    for letter, pixels in zip(letters, zip(*map(str.split, rows), strict=True), strict=True)
}
# Block characters for a pixel above and one below.
BLOCKS = {"..": " ", "#.": "▀", ".#": "▄", "##": "█"}
EIGHTHS = " ▏▎▍▌▋▊▉█"
PERCENT_WIDTH = 6
# Length of the time line: at least, and in multiples of the last mark.
SHORTEST_S, AFTER_FINAL = 4.0, 1.5
# Sum of counts at full height, unless the touch is firmer.
LIGHT_LOAD = 600.0
STEPS = " ▁▂▃▄▅▆▇█"


def pad_picture(pressure: NDArray[np.float64], scale: int, console: Console) -> list[Text]:
    """Return (8, 8) counts above rest as 4 * scale lines of 8 * scale characters."""
    levels = np.log1p(np.maximum(pressure, 0.0) / LIGHT_COUNTS) / np.log1p(FIRM_COUNTS / LIGHT_COUNTS)
    pixels = np.minimum(_stretched(_stretched(levels, scale).T, scale).T, 1.0)
    # With NO_COLOR rich keeps the colour system and drops the colours.
    if console.color_system is None or console.no_color:
        at = np.minimum((pixels[::2] * len(CHARACTERS)).astype(int), len(CHARACTERS) - 1)
        return [Text("".join(CHARACTERS[i] for i in row)) for row in at.tolist()]
    colours = [[COLOURS[shade] for shade in row] for row in np.rint(pixels * (SHADES - 1)).astype(int)]
    return [_pad_line(*pair) for pair in zip(colours[::2], colours[1::2], strict=True)]


def _pad_line(upper: Sequence[str], lower: Sequence[str]) -> Text:
    line, end = Text("▀" * len(upper)), 0
    for pair, run in groupby(zip(upper, lower, strict=True)):
        begin, end = end, end + len(list(run))
        line.stylize(Style.parse("{} on {}".format(*pair)), begin, end)
    return line


def _stretched(rows: NDArray[np.float64], scale: int) -> NDArray[np.float64]:
    """Return N rows of 8 values, linearly interpolated to (N, 8 * scale)."""
    at = (np.arange(COLUMNS * scale) + 0.5) / scale - 0.5
    return np.array([np.interp(at, range(COLUMNS), row) for row in rows])


def big(word: str, width: int) -> list[str]:
    """Return a word in three lines, twice as wide where there is room.

    If the word does not fit or has other letters, return it plain.
    """
    if not word or not set(word.upper()) <= LETTERS.keys():
        return [word]
    rows = [".".join(row) for row in zip(*(LETTERS[letter] for letter in word.upper()), strict=True)]
    if 2 * len(rows[0]) <= width:
        rows = ["".join(2 * pixel for pixel in row) for row in rows]
    if len(rows[0]) > width:
        return [word]
    rows.append("." * len(rows[0]))
    return [
        "".join(BLOCKS[upper + lower] for upper, lower in zip(*pair, strict=True))
        for pair in zip(rows[::2], rows[1::2], strict=True)
    ]


def bars(
    names: Mapping[str, str], shares: Mapping[str, float], stands: str, size: tuple[int, int]
) -> list[Text]:
    """Return one bar for each gesture, or for the likeliest if (width, height) has no room for all.

    names: display names, in order. shares: probabilities, empty for empty bars. stands: the answer now.
    """
    width, height = size
    likeliest = sorted(names, key=lambda gesture: -shares.get(gesture, 0.0))[:height]
    name_width = min(max(map(cell_len, names.values()), default=0), width // 2)
    room = max(width - name_width - 1 - PERCENT_WIDTH, 1)
    lines = []
    for gesture in (gesture for gesture in names if gesture in likeliest):
        share = shares.get(gesture)
        eighths = round((share or 0.0) * room * 8)
        bar = "█" * (eighths // 8) + EIGHTHS[eighths % 8].strip()
        is_answer = gesture == stands
        style = INK if is_answer else MUTED
        number = "-" if share is None else f"{share:.0%}"
        lines.append(
            Text.assemble(
                (f"{set_cell_size(names[gesture], name_width)} ", style),
                (bar, ACCENT if is_answer else MUTED),
                ("─" * (room - len(bar)), RAIL),
                (f"{number:>{PERCENT_WIDTH}}", style),
            )
        )
    return lines


class Flag(NamedTuple):
    """An answer on the time line, and its time."""

    at_s: float
    text: str
    changed: bool


def time_line(
    trace: Sequence[tuple[float, float]],
    marks_s: Sequence[float],
    flags: Sequence[Flag],
    size: tuple[int, int],
) -> list[Text]:
    """Return pressure, marks and answers in (width, height) characters; the last line labels the marks.

    trace: (seconds since the touch began, sum of counts).
    """
    width, height = size
    end_s = max(SHORTEST_S, marks_s[-1] * AFTER_FINAL)

    def column(at_s: float) -> int:
        return min(int(at_s / end_s * width), width - 1)

    loads = [0.0] * width
    for at_s, load in trace:
        if at_s < end_s:
            loads[column(at_s)] = max(loads[column(at_s)], load)
    reached_s = trace[-1][0] if trace else 0.0
    marks = [(column(mark_s), reached_s >= mark_s) for mark_s in marks_s]
    lines = [_with_marks(steps, marks) for steps in _steps(loads, height - 1)]
    # Put each flag a row below the one before, and after the lowest row begin at the top.
    for number, flag in enumerate(flags):
        row = number % len(lines)
        lines[row] = _with_flag(lines[row], flag, column(flag.at_s))
    return [*lines, Text(_labels(marks_s, column, width), MUTED)]


def _steps(loads: Sequence[float], height: int) -> list[list[str]]:
    """Return pressure as the block characters of lines, the highest line first."""
    peak = max(LIGHT_LOAD, *loads)
    # The square root makes light touches visible, as on the live page.
    eighths = [round((load / peak) ** 0.5 * height * 8) for load in loads]
    return [[STEPS[min(max(n - 8 * row, 0), 8)] for n in eighths] for row in reversed(range(height))]


def _with_marks(steps: list[str], marks: Sequence[tuple[int, bool]]) -> Text:
    """Return a line with marks. marks: the column of each, and whether the touch has reached it."""
    for column, is_reached in marks:
        steps[column] = "│" if is_reached else "┊"
    line = Text("".join(steps), TRACE)
    for column, is_reached in marks:
        line.stylize(MUTED if is_reached else RAIL, column, column + 1)
    return line


def _with_flag(line: Text, flag: Flag, column: int) -> Text:
    style = CHANGED_FLAG if flag.changed else ACCENT_FLAG
    text, pole = f" {flag.text} "[: len(line) - 1], style + (CHANGED if flag.changed else ACCENT)
    drawn = Text.assemble(("▌", pole), (text, style))
    # Without room to the right of the mark, the flag hangs to its left.
    if column + drawn.cell_len > line.cell_len:
        column, drawn = max(column - cell_len(text), 0), Text.assemble((text, style), ("▐", pole))
    return Text.assemble(line[:column], drawn, line[column + drawn.cell_len :])


def _labels(marks_s: Sequence[float], column: Callable[[float], int], width: int) -> str:
    line = " " * width
    # The last label first: it must be shown even if there is no room for others.
    for mark_s in (marks_s[-1], *marks_s[:-1]):
        text = f" {mark_s:.3g} s "
        start = min(max(column(mark_s) - len(text) // 2, 0), width - len(text))
        if not line[start : start + len(text)].strip():
            line = line[:start] + text + line[start + len(text) :]
    return line
