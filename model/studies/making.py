"""Commands that make and measure the shipped model: `data`, `train`, `export`, `evaluate`, `stability`."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console

from touchd.model.classifier import SHIPPED_MODEL, ModelError
from touchd.model.studies.folders import study_parser
from touchd.model.training.download import ARCHIVE_URL, obtain
from touchd.model.training.recipe import SHIPPED_RECIPE, read_recipe
from touchd.model.training.studies import Folders

STUDIES = ("haart", "second-study", "third-study")
WEIGHTS: dict[str, Any] = {"type": Path, "default": SHIPPED_MODEL.parent, "help": "folder of the model files"}


def data(arguments: Sequence[str]) -> int:
    """Download what HAART's folder lacks, check everything, print its contents; returns 0."""
    what = "Downloads the HAART recordings from their official place, and checks them."
    parser = study_parser("data", what, "haart")
    parser.add_argument("--url", default=ARCHIVE_URL, help="where the archive lies (%(default)s)")
    options = parser.parse_args(arguments)
    console = Console()
    for name, contents in obtain(options.haart, console, options.url).items():
        people = ", ".join(contents.participants)
        console.print(f"{name}: {contents.recordings} recordings of participants {people}")
    return 0


def train(arguments: Sequence[str]) -> int:
    """Train what is not trained yet, resuming where a training was cut off; returns 0."""
    parser = _recipe_parser("train", "Trains every network of a recipe; run it again to resume.")
    parser.add_argument("--threads", type=int, default=2, help="processor threads, where there is no GPU (2)")
    parser.add_argument(
        "--begin-from", type=Path, help="folder of model files to begin from, without their checkpoints"
    )
    options = parser.parse_args(arguments)

    from touchd.model.training.ship import train_recipe

    recipe, folders = read_recipe(options.recipe), _folders(options)
    train_recipe(recipe, folders, options.runs, options.threads, options.begin_from)
    return 0


def export(arguments: Sequence[str]) -> int:
    """Calibrate on people held out, export, print the files written; returns 0."""
    parser = _recipe_parser("export", "Exports a trained recipe to ONNX.")
    parser.add_argument("--weights", **WEIGHTS)
    options = parser.parse_args(arguments)

    from touchd.model.training.ship import export_recipe

    for path in export_recipe(read_recipe(options.recipe), _folders(options), options.runs, options.weights):
        sys.stdout.write(f"{path}\n")
    return 0


def evaluate(arguments: Sequence[str]) -> int:
    """Print the model's scores on the recordings there are, or write scores.json; returns 0."""
    what = "Scores the model on people whom it never saw: on HAART's, and on further studies' where they are."
    parser = study_parser("evaluate", what, *STUDIES)
    parser.add_argument("--weights", **WEIGHTS)
    parser.add_argument(
        "--write",
        action="store_true",
        help="score all studies in detail, write scores.json beside the model",
    )
    options = parser.parse_args(arguments)
    if not (options.weights / SHIPPED_MODEL.name).exists():
        raise ModelError(f"{options.weights}: no model files there; name their folder with --weights")

    from touchd.model.studies.checks.scores import show, write

    if options.write:
        sys.stdout.write(f"{write(_folders(options), options.weights)}\n")
    else:
        show(_folders(options), options.weights)
    return 0


def stability(arguments: Sequence[str]) -> int:
    """Check a model file's arithmetic; returns 0 when every check passed, 1 when one failed."""
    from touchd.model.studies.checks.stability import run, table

    parser = study_parser("stability", "Checks a model file's arithmetic.")
    parser.add_argument("--model", type=Path, default=SHIPPED_MODEL, help="an ONNX file; ours without it")
    parser.add_argument("--json", action="store_true", help="one JSON array instead of a table")
    parser.add_argument("--hours", type=float, default=0.0, help="also check a stream this long")
    options = parser.parse_args(arguments)
    checks = run(options.model, options.hours)
    if options.json:
        sys.stdout.buffer.write(msgspec.json.encode(checks) + b"\n")
    else:
        Console().print(table(checks))
    return 0 if all(check.passed for check in checks) else 1


def _recipe_parser(name: str, description: str) -> argparse.ArgumentParser:
    parser = study_parser(name, description, *STUDIES)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder for checkpoints (runs)")
    parser.add_argument("--recipe", type=Path, default=SHIPPED_RECIPE, help="YAML file; the shipped model's")
    return parser


def _folders(options: argparse.Namespace) -> Folders:
    return Folders(options.haart, options.second_study, options.third_study)
