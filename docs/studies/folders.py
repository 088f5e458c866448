"""The folders of the two studies' recordings, as several studies take them."""

import argparse
import os
from pathlib import Path

HAART_VARIABLE = "TOUCHD_HAART"
SECOND_STUDY_VARIABLE = "TOUCHD_SECOND_STUDY"


def add_haart_argument(parser: argparse.ArgumentParser) -> None:
    """Add --haart FOLDER, by default the environment's TOUCHD_HAART, else ./haart."""
    _add(parser, "haart", HAART_VARIABLE, "the HAART recordings; `data` fetches them")


def add_second_study_argument(parser: argparse.ArgumentParser) -> None:
    """Add --second-study FOLDER, by default the environment's TOUCHD_SECOND_STUDY, else ./second-study."""
    _add(parser, "second-study", SECOND_STUDY_VARIABLE, "the second study's robot-pad.csv")


def add_docs_argument(parser: argparse.ArgumentParser) -> None:
    """Add --docs FOLDER, where the page to fill in is."""
    parser.add_argument(
        "--docs", type=Path, default=Path("docs"), metavar="FOLDER", help="of the page (docs)"
    )


def _add(parser: argparse.ArgumentParser, name: str, variable: str, what: str) -> None:
    default = Path(os.environ.get(variable, name))
    what = f"folder of {what} (default: ${variable}, else {name})"
    parser.add_argument(f"--{name}", type=Path, default=default, metavar="FOLDER", help=what)
