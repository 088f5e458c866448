"""The folder of HAART recordings, as several commands are told of it."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

HAART_VARIABLE = "TOUCHD_HAART"


def default_haart() -> Path:
    """Return the folder where none is named."""
    return Path(os.environ.get(HAART_VARIABLE, "haart"))


def add_haart_argument(parser: argparse.ArgumentParser) -> None:
    """Add --haart FOLDER, by default the environment's TOUCHD_HAART, else ./haart."""
    parser.add_argument(
        "--haart",
        type=Path,
        default=default_haart(),
        metavar="FOLDER",
        help=f"folder of the HAART recordings (${HAART_VARIABLE}, else haart); `touchd data` fetches them",
    )
