"""The live page's colours in a terminal, with fall-backs for fewer colours."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from rich.console import Console
from rich.style import Style

# The page's dark theme; from no pressure to firm.
HEAT = ("#171c24", "#42249a", "#85248a", "#d04361", "#f9903f", "#fdf4b5")
# The same with sixteen colours.
OLD_HEAT = ("black", "blue", "magenta", "red", "bright_red", "bright_yellow", "bright_white")
SHADES = 64
# Without colours.
CHARACTERS = " ·:-=+*#%@"
# With many colours, and with sixteen.
COLOURS = {
    "ink": ("#f3f5f8", "bright_white"),
    "muted": ("#aab4c2", "white"),
    "faint": ("#5d6877", "white"),
    "accent": ("#7cc4ff", "bright_cyan"),
    "changed": ("#ffb65c", "bright_yellow"),
    "robot": ("#9be7c4", "bright_green"),
    "bad": ("#ff9a9a", "bright_red"),
    "accent_flag": ("#f3f5f8 on #17364f", "bright_white on blue"),
    "changed_flag": ("#ffb65c on #3b2a12", "bright_yellow on black"),
    "rail": ("#2b323d", "bright_black"),
    "trace": ("#2f5d80", "blue"),
}


@dataclass(frozen=True)
class Palette:
    """All styles. heat: from no pressure to firm, empty without colours."""

    paper: Style
    ink: Style
    muted: Style
    faint: Style
    accent: Style
    changed: Style
    robot: Style
    bad: Style
    accent_flag: Style
    changed_flag: Style
    rail: Style
    trace: Style
    heat: tuple[str, ...]


def palette_for(console: Console) -> Palette:
    """Return the palette for a console's colour system."""
    # With NO_COLOR rich keeps the colour system and drops the colours.
    match None if console.no_color else console.color_system:
        case "truecolor" | "256":
            paper, column, heat = "on #0c0f13", 0, _between(HEAT)
        case None:
            paper, column, heat = "", 2, ()
        case _:
            paper, column, heat = "on black", 1, OLD_HEAT
    on_paper = Style.parse(paper)
    styles = {name: on_paper + Style.parse((*both, "")[column]) for name, both in COLOURS.items()}
    return Palette(paper=on_paper, heat=heat, **styles)


@cache
def halves(upper: str, lower: str) -> Style:
    """Return the style of ▀ with one colour above another."""
    return Style(color=upper, bgcolor=lower)


def _between(stops: tuple[str, ...]) -> tuple[str, ...]:
    """Return SHADES colours along the stops."""
    rgb = np.array([[int(stop[i : i + 2], 16) for i in (1, 3, 5)] for stop in stops])
    at = np.linspace(0, len(stops) - 1, SHADES)
    mixed = np.rint([np.interp(at, range(len(stops)), channel) for channel in rgb.T]).astype(int)
    return tuple("#{:02x}{:02x}{:02x}".format(*shade) for shade in mixed.T)
