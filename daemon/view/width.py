"""How wide text is shown: as wide as the terminal, within reason."""

from shutil import get_terminal_size

LEAST, MOST = 40, 80


def text_width() -> int:
    """Return the number of characters in a line."""
    return max(LEAST, min(MOST, get_terminal_size().columns))
