"""The pad in half blocks, so that taxels are square, in the live page's colours."""

from collections.abc import Iterable
from functools import cache
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.style import Style
from rich.text import Text

from touchd.drivers.frame import COLUMNS

# As on the live page: colours follow the logarithm of pressure, from "light" to "firm" counts.
LIGHT_COUNTS = 4.0
FIRM_COUNTS = 250.0
# The page's dark theme, which rich turns into the terminal's colours; from no pressure to firm.
HEAT = ("#171c24", "#42249a", "#85248a", "#d04361", "#f9903f", "#fdf4b5")
SHADES = 64
# Without colours.
CHARACTERS = " ·:-=+*#%@"


def heat_of(console: Console) -> tuple[str, ...]:
    """Return the colours from no pressure to firm, none for a console without colours."""
    # With NO_COLOR rich keeps the colour system and drops the colours.
    return _between(HEAT) if console.color_system is not None and not console.no_color else ()


def pad_picture(pressure: NDArray[np.float64], scale: int, console: Console) -> list[Text]:
    """Return (8, 8) counts above rest as 4 * scale lines of 8 * scale characters."""
    heat = heat_of(console)
    levels = np.log1p(np.maximum(pressure, 0.0) / LIGHT_COUNTS) / np.log1p(FIRM_COUNTS / LIGHT_COUNTS)
    weights = _weights(scale)
    pixels = np.clip(weights @ levels @ weights.T, 0.0, 1.0)
    if not heat:
        at = np.minimum((pixels[::2] * len(CHARACTERS)).astype(int), len(CHARACTERS) - 1)
        return [Text("".join(CHARACTERS[i] for i in row)) for row in at.tolist()]
    shades = np.rint(pixels * (len(heat) - 1)).astype(int).tolist()
    return [
        joined(("▀", _halves(heat[a], heat[b])) for a, b in zip(upper, lower, strict=True))
        for upper, lower in zip(shades[::2], shades[1::2], strict=True)
    ]


def joined(cells: Iterable[tuple[str, Style]]) -> Text:
    """Return a line of characters with their styles."""
    line = Text()
    for style, run in groupby(cells, key=lambda cell: cell[1]):
        line.append("".join(character for character, _ in run), style)
    return line


@cache
def _halves(upper: str, lower: str) -> Style:
    """Return the style of ▀ with one colour above another."""
    return Style(color=upper, bgcolor=lower)


@cache
def _between(stops: tuple[str, ...]) -> tuple[str, ...]:
    """Return SHADES colours along the stops."""
    rgb = np.array([[int(stop[i : i + 2], 16) for i in (1, 3, 5)] for stop in stops])
    at = np.linspace(0, len(stops) - 1, SHADES)
    mixed = np.rint([np.interp(at, range(len(stops)), channel) for channel in rgb.T]).astype(int)
    return tuple("#{:02x}{:02x}{:02x}".format(*shade) for shade in mixed.T)


@cache
def _weights(scale: int) -> NDArray[np.float64]:
    """Return the weights of linear interpolation, (8 * scale, 8)."""
    at = (np.arange(COLUMNS * scale) + 0.5) / scale - 0.5
    distance = np.abs(np.clip(at, 0, COLUMNS - 1)[:, None] - np.arange(COLUMNS)[None, :])
    return np.maximum(0.0, 1.0 - distance)
