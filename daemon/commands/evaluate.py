"""`touchd evaluate`: the shipped model's scores on HAART, as a file and a page."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from daemon.commands.haart_folder import add_haart_argument


def main(arguments: Sequence[str]) -> int:
    """Write scores.json beside the model, and docs/accuracy.md from it; returns 0."""
    parser = argparse.ArgumentParser(
        prog="touchd evaluate",
        description="Scores the model on the test participants, and on the training participants left out.",
    )
    add_haart_argument(parser)
    parser.add_argument(
        "--weights", type=Path, default=Path("model/weights"), help="folder of the model files"
    )
    parser.add_argument("--page", type=Path, default=Path("docs/accuracy.md"), help="page to write")
    options = parser.parse_args(arguments)

    from model.evaluate import write_scores
    from model.report import write_page
    from model.ship import SCORES_NAME, evaluate_shipped

    scores = evaluate_shipped(options.haart, options.weights, "touchd evaluate")
    write_scores(scores, options.weights / SCORES_NAME)
    write_page(scores, options.page)
    for row in scores.test.realigned:
        sys.stdout.write(f"{row.frames:4d} frames: {100 * row.accuracy:.1f} % on the test participants\n")
    sys.stdout.write(f"{options.weights / SCORES_NAME}\n{options.page}\n")
    return 0
