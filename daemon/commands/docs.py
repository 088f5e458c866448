"""`touchd docs`: prints a page of the documentation."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

PAGES = {page.stem: page for page in sorted((Path(__file__).parents[2] / "docs").glob("*.md"))}


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd docs",
        description="Prints a page of the documentation; without a name, the names of all pages.",
    )
    parser.add_argument("page", nargs="?", choices=list(PAGES), help="the page")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Print the page as Markdown; returns 0."""
    page = parser().parse_args(arguments).page
    names = "".join(f"{name}\n" for name in PAGES)
    sys.stdout.write(names if page is None else PAGES[page].read_text(encoding="utf-8"))
    return 0
