"""The report: measures what is missing, then fills the tables of docs/report.md and draws its pictures."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from docs.studies.folders import add_docs_argument, add_haart_argument
from docs.studies.marked import fill
from docs.studies.report import cost, front, representation, table1, tables23
from docs.studies.report.results import Results, Study

PARTS = {
    "table1": table1,
    "tables23": tables23,
    "representation": representation,
    "front": front,
    "cost": cost,
}
PAGE_NAME = "report.md"
RESULTS_NAME = "report.json"


def main(arguments: Sequence[str]) -> int:
    """Measure the parts that are asked for, then write the page from all stored results; returns 0."""
    parser = argparse.ArgumentParser(
        prog="python -m docs.studies report",
        description="Trains and measures what the report lacks, then writes it. Run it again to go on.",
    )
    add_haart_argument(parser)
    parser.add_argument(
        "--only",
        nargs="*",
        choices=PARTS,
        default=list(PARTS),
        help="parts to measure; all without it; none: page alone",
    )
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder for checkpoints (runs)")
    add_docs_argument(parser)
    parser.add_argument("--threads", type=int, default=2, help="processor threads, where there is no GPU (2)")
    options = parser.parse_args(arguments)
    results = Results(options.docs / RESULTS_NAME)
    study = Study(options.haart, options.runs, results, options.threads, options.docs)
    for name in options.only:
        PARTS[name].run(study)
    fill(options.docs / PAGE_NAME, tables(results))
    for part in PARTS.values():
        part.draw(results, options.docs / "figures")
    sys.stdout.write(f"{options.docs / PAGE_NAME}\n")
    return 0


def tables(results: Results) -> dict[str, str]:
    """Return the tables of all parts by their places on the page."""
    return {name: made for part in PARTS.values() for name, made in part.tables(results).items()}
