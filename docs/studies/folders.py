"""The folders of the two studies' recordings, as several studies take them."""

import argparse
import os
from pathlib import Path

HAART_VARIABLE = "TOUCHD_HAART"
SECOND_STUDY_VARIABLE = "TOUCHD_SECOND_STUDY"


def add_haart_argument(parser: argparse.ArgumentParser) -> None:
    """Add --haart FOLDER, by default the environment's TOUCHD_HAART, else ./haart."""
    parser.add_argument(
        "--haart",
        type=Path,
        default=Path(os.environ.get(HAART_VARIABLE, "haart")),
        metavar="FOLDER",
        help=f"folder of the HAART recordings (${HAART_VARIABLE}, else haart); `data` fetches them",
    )


def add_second_study_argument(parser: argparse.ArgumentParser) -> None:
    """Add --second-study FOLDER, by default the environment's TOUCHD_SECOND_STUDY, else ./second-study."""
    parser.add_argument(
        "--second-study",
        type=Path,
        default=Path(os.environ.get(SECOND_STUDY_VARIABLE, "second-study")),
        metavar="FOLDER",
        help=f"folder of the second study's robot-pad.csv (${SECOND_STUDY_VARIABLE}, else second-study)",
    )
