"""The command line of a study, with the folders that several studies take."""

import argparse
import os
from pathlib import Path

RECORDINGS = {
    "haart": ("TOUCHD_HAART", "the HAART recordings; `data` fetches them"),
    "second-study": ("TOUCHD_SECOND_STUDY", "the second study's robot-pad.csv"),
}


def study_parser(name: str, description: str | None = None, *takes: str) -> argparse.ArgumentParser:
    """Return the parser of a study that takes some of these folders: "haart", "second-study", "docs".

    Recordings are by default where the environment's variable says, else in ./haart and ./second-study.
    """
    parser = argparse.ArgumentParser(prog=f"python -m docs.studies {name}", description=description)
    for folder in takes:
        if folder == "docs":
            default, what = Path("docs"), "of the page (docs)"
        else:
            variable, recordings = RECORDINGS[folder]
            default = Path(os.environ.get(variable, folder))
            what = f"folder of {recordings} (default: ${variable}, else {folder})"
        parser.add_argument(f"--{folder}", type=Path, default=default, metavar="FOLDER", help=what)
    return parser


def add_haart_argument(parser: argparse.ArgumentParser) -> None:
    """Add --haart FOLDER, by default the environment's TOUCHD_HAART, else ./haart."""
    _add(parser, "haart")


def add_second_study_argument(parser: argparse.ArgumentParser) -> None:
    """Add --second-study FOLDER, by default the environment's TOUCHD_SECOND_STUDY, else ./second-study."""
    _add(parser, "second-study")


def add_docs_argument(parser: argparse.ArgumentParser) -> None:
    """Add --docs FOLDER, where the page to fill in is."""
    parser.add_argument(
        "--docs", type=Path, default=Path("docs"), metavar="FOLDER", help="of the page (docs)"
    )


def _add(parser: argparse.ArgumentParser, name: str) -> None:
    variable, recordings = RECORDINGS[name]
    what = f"folder of {recordings} (default: ${variable}, else {name})"
    default = Path(os.environ.get(variable, name))
    parser.add_argument(f"--{name}", type=Path, default=default, metavar="FOLDER", help=what)
