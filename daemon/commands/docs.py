"""`touchd docs`: prints a page of the documentation."""

import argparse
import sys
from pathlib import Path

PAGES = {page.stem: page for page in sorted((Path(__file__).parents[2] / "docs").glob("*.md"))}
DESCRIPTION = "Prints a page of the documentation; without a name, the names of all pages."


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("page", nargs="?", choices=list(PAGES), help="the page")


def main(options: argparse.Namespace) -> int:
    """Print the page as Markdown; returns 0."""
    names = "".join(f"{name}\n" for name in PAGES)
    sys.stdout.write(names if options.page is None else PAGES[options.page].read_text(encoding="utf-8"))
    return 0
