"""`touchd docs`: prints a page of the documentation."""

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown

from touchd.daemon.view.terminal import text_width

# Pictures, and the marks around tables: a terminal shows neither.
NOT_FOR_TERMINALS = re.compile(r"^(?:!\[.*\]\(.*\)|<!--.*-->)\n\n?", re.MULTILINE)
PAGES = {page.stem: page for page in sorted((Path(__file__).parents[2] / "docs").glob("*.md"))}


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd docs",
        description="Prints a page of the documentation; without a name, the names of all pages.",
    )
    parser.add_argument("page", nargs="?", choices=list(PAGES), help="the page")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Print the page, laid out for a terminal, else as Markdown; returns 0."""
    page = parser().parse_args(arguments).page
    if page is None:
        sys.stdout.write("".join(f"{name}\n" for name in PAGES))
        return 0
    text = PAGES[page].read_text(encoding="utf-8")
    if sys.stdout.isatty():
        Console(width=text_width()).print(Markdown(NOT_FOR_TERMINALS.sub("", text)))
    else:
        sys.stdout.write(text)
    return 0
