"""Parts of the view: words in large letters, the probabilities as bars, and the time line of a touch."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rich.style import Style
from rich.text import Text

from touchd.daemon.view.pad_picture import Palette, joined

LETTER_ROWS = 5
# Five rows a letter, from top to bottom; a dot is empty.
LETTERS = {
    "A": ".#. #.# ### #.# #.#",
    "B": "##. #.# ##. #.# ##.",
    "C": ".## #.. #.. #.. .##",
    "D": "##. #.# #.# #.# ##.",
    "E": "### #.. ##. #.. ###",
    "F": "### #.. ##. #.. #..",
    "G": ".## #.. #.# #.# .##",
    "H": "#.# #.# ### #.# #.#",
    "I": "# # # # #",
    "J": "..# ..# ..# #.# .#.",
    "K": "#..# #.#. ##.. #.#. #..#",
    "L": "#.. #.. #.. #.. ###",
    "M": "#...# ##.## #.#.# #...# #...#",
    "N": "#..# ##.# #.## #..# #..#",
    "O": ".#. #.# #.# #.# .#.",
    "P": "##. #.# ##. #.. #..",
    "Q": ".##. #..# #..# #.#. .#.#",
    "R": "##. #.# ##. #.# #.#",
    "S": ".## #.. .#. ..# ##.",
    "T": "### .#. .#. .#. .#.",
    "U": "#.# #.# #.# #.# ###",
    "V": "#.# #.# #.# #.# .#.",
    "W": "#...# #...# #.#.# ##.## #...#",
    "X": "#.# #.# .#. #.# #.#",
    "Y": "#.# #.# .#. .#. .#.",
    "Z": "### ..# .#. #.. ###",
    "Ä": "#.# .#. #.# ### #.#",
    "Ö": "#.# .#. #.# #.# .#.",
    "Ü": "#.# ... #.# #.# ###",
    "-": "... ... ### ... ...",
    " ": ".. .. .. .. ..",
}
# Block characters for a pixel above and one below.
BLOCKS = {"..": " ", "#.": "▀", ".#": "▄", "##": "█"}
EIGHTHS = " ▏▎▍▌▋▊▉█"
PERCENT_WIDTH = 6
# Of the time line: its length, at least and after the last mark.
SHORTEST_S, AFTER_FINAL = 4.0, 1.5
# Sum of counts at full height, unless the touch is firmer.
LIGHT_LOAD = 600.0
# From this width on, every mark shows its unit.
ROOMY = 40
STEPS = " ▁▂▃▄▅▆▇█"

Cells = list[list[tuple[str, Style]]]


def big(word: str, width: int) -> list[str]:
    """Return a word in three lines, twice as wide where there is room.

    If the word does not fit or has other letters, return it plain.
    """
    letters = [LETTERS.get(letter) for letter in word.upper()]
    if None in letters:
        return [word]
    rows = [".".join((letter or "").split()[row] for letter in letters) for row in range(LETTER_ROWS)]
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
    names: Mapping[str, str],
    shares: Mapping[str, float],
    stands: str,
    size: tuple[int, int],
    palette: Palette,
) -> list[Text]:
    """Return one bar for each gesture, only the likeliest where (width, height) has no room for all.

    names: display names, in order. shares: probabilities, empty for empty bars. stands: the answer now.
    """
    width, height = size
    likeliest = sorted(names, key=lambda gesture: -shares.get(gesture, 0.0))[:height]
    name_width = min(max((len(name) for name in names.values()), default=0), width // 2)
    room = max(width - name_width - 1 - PERCENT_WIDTH, 1)
    lines = []
    for gesture in (gesture for gesture in names if gesture in likeliest):
        share = shares.get(gesture)
        eighths = round((share or 0.0) * room * 8)
        bar = "█" * (eighths // 8) + EIGHTHS[eighths % 8].strip()
        is_answer = gesture == stands
        style = palette.ink if is_answer else palette.muted
        number = "-" if share is None else f"{share:.0%}"
        lines.append(
            Text.assemble(
                (f"{names[gesture][:name_width]:<{name_width}} ", style),
                (bar, palette.accent if is_answer else palette.muted),
                ("─" * (room - len(bar)), palette.rail),
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
    palette: Palette,
) -> list[Text]:
    """Return pressure, marks and answers in (width, height) characters; the last line labels the marks.

    trace: (seconds since the touch began, sum of counts).
    """
    width, height = size
    end_s = max(SHORTEST_S, marks_s[-1] * AFTER_FINAL)
    cells: Cells = [[(" ", palette.paper)] * width for _ in range(height - 1)]
    _draw_trace(cells, trace, end_s, palette)
    reached_s = trace[-1][0] if trace else 0.0
    for mark_s in marks_s:
        mark = ("│", palette.muted) if reached_s >= mark_s else ("┊", palette.rail)
        for row in cells:
            row[_column(mark_s, end_s, width)] = mark
    _draw_flags(cells, flags, end_s, palette)
    return [*map(joined, cells), Text(_labels(marks_s, end_s, width), palette.muted)]


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


def _labels(marks_s: Sequence[float], end_s: float, width: int) -> str:
    line = [" "] * width
    # The last label first: where there is room for one alone, it names the end.
    for mark_s in (marks_s[-1], *marks_s[:-1]):
        text = f"{mark_s:.3g} s" if width >= ROOMY or mark_s == marks_s[-1] else f"{mark_s:.3g}"
        start = min(max(_column(mark_s, end_s, width) - len(text) // 2, 0), width - len(text))
        if not "".join(line[max(start - 1, 0) : start + len(text) + 1]).strip():
            line[start : start + len(text)] = text
    return "".join(line)
