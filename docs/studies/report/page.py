"""The page docs/report.md: every part's section, from the stored results alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from docs.studies.report import challenge, cost, front, paper_tables, representation, table2, table3
from docs.studies.report.results import Results
from docs.studies.report.study import Study

PAGE_NAME = "report.md"
RESULTS_NAME = "report.json"


@dataclass(frozen=True)
class Part:
    """One part of the study. run: measures what is missing; draw: its pictures, where it has any."""

    name: str
    title: str
    run: Callable[[Study], None]
    section: Callable[[Results], str]
    draw: Callable[[Results, Path], None] | None = None


INTRODUCTION = """\
# The paper's tables, and ours beside them

`python -m docs.studies report` trains and measures what is missing here, then writes this page again;
`--only PART` does a part. All figures are in [report.json](report.json), each with the command, commit,
machine and day of its making.

The paper is Ren, Hou and Belpaeme, HRI 2023 Companion. Windows and score are its own: each recording cut into
432 // L windows of L frames as published, accuracy averaged over the seven gestures, in percent, on the
challenge's test participants T1, T2 and T9. Its network comes in two variants: *printed*, as its text and
figure 1 have it, and *public*, as its code has it, which is lighter.

Its code keeps the epoch that does best on the test participants. So does the column *best epoch on test*, to
compare with what it prints; such a figure is too high. *Last epoch* is the honest one: the number of epochs
was fixed beforehand, and nothing was chosen on these participants. (The test file has one more leading column
than the training file. Some public loaders feed it to the network; the paper's code does not.)
"""

PARTS = (
    Part("challenge", "Table 1: the challenge's systems", challenge.run, challenge.section, challenge.draw),
    Part("table3", "Table 3: how long the window is", table3.run, table3.section, table3.draw),
    Part("table2", "Table 2: how many blocks", table2.run, table2.section),
    Part(
        "representation",
        "Figures 2 and 3: what is confused, and what is learnt",
        representation.run,
        representation.section,
        representation.draw,
    ),
    Part("front", "Speed against error", front.run, front.section, front.draw),
    Part("cost", "Cost as the window grows and as pads are added", cost.run, cost.section, cost.draw),
)


def write_page(results: Results, docs: Path) -> Path:
    """Write the page and its pictures from the results; return the page."""
    figures = docs / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    for part in PARTS:
        if part.draw is not None:
            part.draw(results, figures)
    page = docs / PAGE_NAME
    page.write_text("\n".join(page_lines(results)) + "\n", encoding="utf-8")
    return page


def page_lines(results: Results) -> Iterator[str]:
    """Yield the page's lines."""
    yield INTRODUCTION
    yield from paper_tables.what_was_cut(results)
    for part in PARTS:
        yield f"## {part.title}"
        yield ""
        yield part.section(results).strip()
        yield ""
    yield "## What made the paper's networks"
    yield ""
    yield from paper_tables.makings(results)
