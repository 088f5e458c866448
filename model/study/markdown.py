"""How the study's figures are written down: tables, means with their spread, and where they come from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from model.study.results import Cell, Results


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Yield a table's lines and an empty one after it."""
    yield f"| {' | '.join(headings)} |"
    yield f"|{'---|' * len(headings)}"
    for row in rows:
        yield f"| {' | '.join(row)} |"
    yield ""


def percent(shares: Sequence[float]) -> str:
    """Return the mean share in percent, "± sd" after it where there are several; "" for none."""
    if not shares:
        return ""
    mean = f"{100 * np.mean(shares):.1f}"
    return f"{mean} ± {100 * np.std(shares, ddof=1):.1f}" if len(shares) > 1 else mean


def provenance(results: Results, prefix: str) -> str:
    """Return which command, commit and machine made the cells whose keys begin with `prefix`; "" for none."""
    cells = [results.cell(key) for key in results.keys(prefix)]
    makings = sorted({_making(cell) for cell in cells})
    return "; ".join(makings)


def _making(cell: Cell) -> str:
    return f"`{cell.command}`, commit {cell.commit or 'unknown'}, {cell.date}, on {cell.machine}"
