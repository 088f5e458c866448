"""The paper's tables and figures beside ours, as a page, pictures and a file of results."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from daemon.commands.haart_folder import add_haart_argument

PART_NAMES = ("table3", "table2", "challenge", "representation", "front", "cost")


def main(arguments: Sequence[str]) -> int:
    """Measure what is not measured yet, then write the page from everything that is; returns 0."""
    parser = argparse.ArgumentParser(
        prog="python -m docs.studies report",
        description="Trains and measures what the report lacks, then writes it. Run it again to go on.",
    )
    add_haart_argument(parser)
    parser.add_argument(
        "--only",
        nargs="*",
        choices=PART_NAMES,
        default=PART_NAMES,
        help="parts to measure; all without it; none: page alone",
    )
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder for checkpoints (runs)")
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the page (docs)")
    parser.add_argument("--threads", type=int, default=2, help="processor threads, where there is no GPU (2)")
    options = parser.parse_args(arguments)

    from docs.studies.report.page import PARTS, RESULTS_NAME, write_page
    from docs.studies.report.results import Results
    from docs.studies.report.study import Study

    study = Study(
        haart=options.haart,
        runs=options.runs,
        results=Results(options.docs / RESULTS_NAME),
        threads=options.threads,
        docs=options.docs,
    )
    for part in PARTS:
        if part.name in options.only:
            part.run(study)
    sys.stdout.write(f"{write_page(study.results, options.docs)}\n")
    return 0
