"""Fills a study's tables into their places on a hand-written page.

A place is everything from `<!-- table: NAME -->` to `<!-- end -->`.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from touchd.drivers.errors import TouchdError

PLACE = re.compile(r"(<!-- table: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


class PageError(TouchdError):
    """A page has no place for a table; the message names it."""


def table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table."""
    first, *others = [f"| {' | '.join(map(str, row))} |" for row in (headings, *rows)]
    return "\n".join((first, "|" + "---|" * len(headings), *others))


def percent(share: float) -> str:
    """Return a share in percent, with one digit."""
    return f"{100 * share:.1f}"


def fill(page: Path, tables: Mapping[str, str]) -> None:
    """Put each table into its place, and change nothing else; raises PageError if a place is missing."""
    text = page.read_text(encoding="utf-8")
    if homeless := tables.keys() - {name for _, name, _ in PLACE.findall(text)}:
        raise PageError(f"{page}: no place for the table {', '.join(sorted(homeless))}")

    def filled(place: re.Match[str]) -> str:
        return f"{place[1]}\n{tables[place[2]].strip()}\n\n{place[3]}" if place[2] in tables else place[0]

    page.write_text(PLACE.sub(filled, text), encoding="utf-8")
