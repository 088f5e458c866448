"""Fills a study's tables into the places that a hand-written page marks for them.

A place is everything from `<!-- table: NAME -->` to `<!-- end -->`.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from touchd.drivers.errors import TouchdError

PLACE = re.compile(r"(<!-- table: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


class PageError(TouchdError):
    """A page and its tables do not match; the message names the table."""


def table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def fill(page: Path, tables: Mapping[str, str], others: Sequence[str] = ()) -> None:
    """Put each table into its place, and leave everything else as it is.

    others: places that another study fills. Raises PageError when a table has no place, or a place no table.
    """
    text = page.read_text(encoding="utf-8")
    if unmatched := {name for _, name, _ in PLACE.findall(text)} ^ {*tables, *others}:
        raise PageError(f"{page}: table and place must go together: {', '.join(sorted(unmatched))}")

    def filled(place: re.Match[str]) -> str:
        return f"{place[1]}\n{tables[place[2]].strip()}\n\n{place[3]}" if place[2] in tables else place[0]

    page.write_text(PLACE.sub(filled, text), encoding="utf-8")
