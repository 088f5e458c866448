"""The pad in half blocks, so that taxels are square."""

from collections.abc import Sequence
from functools import cache
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from rich.segment import Segment
from rich.text import Text

from touchd.daemon.view.palette import CHARACTERS, Palette, halves
from touchd.drivers.frame import COLUMNS

# As on the live page: colours follow the logarithm of pressure, from "light" to "firm" counts.
LIGHT_COUNTS = 4.0
FIRM_COUNTS = 250.0

DrawnLine = list[Segment]


def level_of(pressure: NDArray[np.float64], firm: float = FIRM_COUNTS) -> NDArray[np.float64]:
    """Return counts above rest as levels from 0 to 1."""
    levels = np.log1p(np.maximum(pressure, 0.0) / LIGHT_COUNTS) / np.log1p(firm / LIGHT_COUNTS)
    clipped: NDArray[np.float64] = np.minimum(levels, 1.0)
    return clipped


def pad_picture(levels: NDArray[np.float64], scale: int, palette: Palette) -> list[DrawnLine]:
    """Return (8, 8) levels as 4 * scale lines of 8 * scale characters."""
    weights = _weights(scale)
    pixels = np.clip(weights @ levels @ weights.T, 0.0, 1.0)
    if not palette.heat:
        return [_in_characters(row) for row in pixels[::2]]
    shades = np.rint(pixels * (len(palette.heat) - 1)).astype(int)
    return [_in_halves(upper, lower, palette) for upper, lower in zip(shades[::2], shades[1::2], strict=True)]


def as_text(lines: Sequence[DrawnLine]) -> Text:
    """Return lines as one text, to be placed beside others."""
    return Text("\n").join(Text.assemble(*((part.text, part.style or "") for part in line)) for line in lines)


def _in_halves(upper: NDArray[np.int_], lower: NDArray[np.int_], palette: Palette) -> DrawnLine:
    heat = palette.heat
    runs = groupby(zip(upper.tolist(), lower.tolist(), strict=True))
    return [Segment("▀" * len(list(run)), halves(heat[a], heat[b])) for (a, b), run in runs]


def _in_characters(row: NDArray[np.float64]) -> DrawnLine:
    at = np.minimum((row * len(CHARACTERS)).astype(int), len(CHARACTERS) - 1)
    return [Segment("".join(CHARACTERS[i] for i in at.tolist()))]


@cache
def _weights(scale: int) -> NDArray[np.float64]:
    """Return the weights of linear interpolation, (8 * scale, 8)."""
    at = (np.arange(COLUMNS * scale) + 0.5) / scale - 0.5
    distance = np.abs(np.clip(at, 0, COLUMNS - 1)[:, None] - np.arange(COLUMNS)[None, :])
    return np.maximum(0.0, 1.0 - distance)
