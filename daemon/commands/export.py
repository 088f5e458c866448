"""`touchd export`: trained networks into ONNX files that take raw counts; needs the extra `train`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from daemon.commands.haart_folder import add_haart_argument, add_second_study_argument


def parser() -> argparse.ArgumentParser:
    """Return what the command line takes."""
    parser = argparse.ArgumentParser(prog="touchd export", description="Exports a trained recipe to ONNX.")
    add_haart_argument(parser)
    add_second_study_argument(parser)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder of checkpoints (runs)")
    parser.add_argument("--recipe", type=Path, help="YAML file; the recipe of the shipped model without it")
    parser.add_argument("--weights", type=Path, default=Path("model/weights"), help="where the files go")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Calibrate on left-out participants, export, name the files written; returns 0."""
    options = parser().parse_args(arguments)

    from model.training.recipe import SHIPPED_RECIPE, read_recipe
    from model.training.ship import export_recipe
    from model.training.studies import Folders

    recipe = read_recipe(options.recipe or SHIPPED_RECIPE)
    folders = Folders(options.haart, options.second_study)
    for path in export_recipe(recipe, folders, options.runs, options.weights):
        sys.stdout.write(f"{path}\n")
    return 0
