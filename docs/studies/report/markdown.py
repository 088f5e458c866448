"""How the study's figures are written down: tables, means with their spread, and where they come from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from docs.studies.report.results import Results


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
    """Return which commands, commits and machines made the cells whose keys begin with `prefix`, and when."""
    cells = [results.cell(key) for key in results.keys(prefix)]
    if not cells:
        return "nothing yet"
    commands = _listed(f"`{cell.command}`" for cell in cells)
    commits = _listed(cell.commit or "unknown" for cell in cells)
    days, machines = _listed(cell.date for cell in cells), _listed(cell.machine for cell in cells)
    return f"{commands}; commit {commits}; {days}; {machines}"


def _listed(words: Iterable[str]) -> str:
    return ", ".join(sorted(set(words)))
