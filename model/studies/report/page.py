"""The report: measures what is missing, then fills the tables of docs/report.md and draws its pictures."""

import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill
from touchd.model.studies.report import cost, front, representation, table1, tables23
from touchd.model.studies.report.results import Results, Study

PARTS: dict[str, ModuleType] = {
    part.__name__.rpartition(".")[2]: part for part in (table1, tables23, representation, front, cost)
}


def main(arguments: Sequence[str]) -> int:
    """Measure the parts that are asked for, then write the page from all stored results; returns 0."""
    what = "Trains and measures what the report lacks, then writes it. Run it again to go on."
    parser = study_parser("report", what, "haart", "docs")
    parser.add_argument(
        "--only",
        nargs="*",
        choices=PARTS,
        default=list(PARTS),
        help="parts to measure; all without it; none: page alone",
    )
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder for checkpoints (runs)")
    parser.add_argument("--threads", type=int, default=2, help="processor threads, where there is no GPU (2)")
    options = parser.parse_args(arguments)
    page, results = options.docs / "report.md", Results(options.docs / "report.json")
    study = Study(options.haart, options.runs, results, options.threads, options.docs)
    for name in options.only:
        PARTS[name].run(study)
    fill(page, tables(results))
    for part in PARTS.values():
        part.draw(results, options.docs / "figures")
    sys.stdout.write(f"{page}\n")
    return 0


def tables(results: Results) -> dict[str, str]:
    """Return the tables of all parts by their places on the page."""
    return {name: made for part in PARTS.values() for name, made in part.tables(results).items()}
