"""The pad in characters: as it is pressed now, or as it was on average."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rich.color import Color
from rich.style import Style
from rich.text import Text

from drivers.frame import COLUMNS

TAXEL_WIDTH = 4
# With a border.
PAD_WIDTH = COLUMNS * TAXEL_WIDTH + 2
# Seen where a terminal has no colours.
SHADES = " .:-=+*#%@"


def pad_picture(pressure: NDArray[np.uint16] | NDArray[np.float64], highest: float) -> Text:
    """Return (8, 8) counts as 8 lines of 32 characters, from dark at 0 to bright at `highest`."""
    # The root lifts light touches, which would else be lost beside a press.
    levels = np.sqrt(np.clip(pressure / highest, 0.0, 1.0))
    lines = [Text().join(_taxel(float(level)) for level in row) for row in levels]
    return Text("\n").join(lines)


def _taxel(level: float) -> Text:
    """Return a taxel pressed at `level` (0 to 1): from dark through red and yellow to white."""
    shade = SHADES[min(int(level * len(SHADES)), len(SHADES) - 1)]
    red, green, blue = (round(255 * min(max(3 * level - step, 0.0), 1.0)) for step in range(3))
    color = Color.from_rgb(max(red, 40), max(green, 40), max(blue, 60))
    return Text(shade * TAXEL_WIDTH, Style(color=color, bgcolor=color))
