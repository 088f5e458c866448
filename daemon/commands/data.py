"""`touchd data`: fetches the HAART recordings, or checks a folder of them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from rich.console import Console

from daemon.commands.haart_folder import add_haart_argument
from model.training.download import ARCHIVE_URL, obtain


def parser() -> argparse.ArgumentParser:
    """Return what the command line takes."""
    parser = argparse.ArgumentParser(
        prog="touchd data",
        description="Downloads the HAART recordings from their official place, resumably, and checks them.",
    )
    add_haart_argument(parser)
    parser.add_argument("--url", default=ARCHIVE_URL, help="where the archive lies (%(default)s)")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Download what is missing, check everything, say what is there; returns 0."""
    options = parser().parse_args(arguments)
    console = Console()
    options.haart.mkdir(parents=True, exist_ok=True)
    for name, contents in obtain(options.haart, console, options.url).items():
        people = ", ".join(contents.participants)
        console.print(f"{name}: {contents.recordings} recordings of participants {people}")
    return 0
