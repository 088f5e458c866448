"""`touchd evaluate`: the shipped model's scores on both studies, as a file."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from daemon.commands.haart_folder import add_haart_argument, add_second_study_argument
from model.classifier import SHIPPED_MODEL, ModelError


def parser() -> argparse.ArgumentParser:
    """Return what the command line takes."""
    parser = argparse.ArgumentParser(
        prog="touchd evaluate",
        description="Scores the model on the test participants, and on both studies' people left out.",
    )
    add_haart_argument(parser)
    add_second_study_argument(parser)
    parser.add_argument(
        "--weights", type=Path, default=Path("model/weights"), help="folder of the model files"
    )
    return parser


def main(arguments: Sequence[str]) -> int:
    """Write scores.json beside the model; returns 0."""
    options = parser().parse_args(arguments)
    if not (options.weights / SHIPPED_MODEL.name).exists():
        raise ModelError(
            f"{options.weights}: no model files there; run this in the repository, or name their folder "
            "with --weights"
        )

    from model.checks.evaluate import write_scores
    from model.training.ship import SCORES_NAME, evaluate_shipped
    from model.training.studies import Folders

    folders = Folders(options.haart, options.second_study)
    scores = evaluate_shipped(folders, options.weights, "touchd evaluate")
    write_scores(scores, options.weights / SCORES_NAME)
    for row, left_out, second in zip(
        scores.test.realigned, scores.left_out.realigned, scores.second_study.realigned, strict=True
    ):
        sys.stdout.write(
            f"{row.frames:4d} frames: {100 * row.accuracy:.1f} % on the test participants, "
            f"{100 * left_out.accuracy:.1f} % on the training participants left out, "
            f"{100 * second.accuracy:.1f} % on the second study's people\n"
        )
    sys.stdout.write(f"{options.weights / SCORES_NAME}\n")
    return 0
