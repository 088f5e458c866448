"""Commands that make and measure the shipped model.

`data`, `train`, `export`, `detector`, `evaluate`, `stability`.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
from rich.console import Console

from touchd.model.classifier import SHIPPED_MODEL, ModelError
from touchd.model.studies.folders import STUDIES, folders_of, study_parser
from touchd.model.training.download import ARCHIVE_URL, obtain
from touchd.model.training.recipe import SHIPPED_RECIPE, read_recipe


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

    recipe, folders = read_recipe(options.recipe), folders_of(options)
    train_recipe(recipe, folders, options.runs, options.threads, options.begin_from)
    return 0


def export(arguments: Sequence[str]) -> int:
    """Calibrate on people held out, export, print the files written; returns 0."""
    options = _recipe_parser("export", "Exports a trained recipe to ONNX.", "weights").parse_args(arguments)

    from touchd.model.training.ship import export_recipe

    recipe, folders = read_recipe(options.recipe), folders_of(options)
    for path in export_recipe(recipe, folders, options.runs, options.weights):
        sys.stdout.write(f"{path}\n")
    return 0


def detector(arguments: Sequence[str]) -> int:
    """Train what is not trained yet, resuming where a training was cut off, and export it; returns 0."""
    parser = study_parser("detector", "Trains and exports the detectors.", *STUDIES, "runs", "weights")
    parser.add_argument("--only", default="", help="one of them by its file's name, such as fold1")
    options = parser.parse_args(arguments)

    import torch

    from touchd.model.training.detector.data import composer
    from touchd.model.training.detector.export import export as write_file
    from touchd.model.training.detector.train import DetectorRecipe
    from touchd.model.training.detector.train import train as train_network

    torch.set_num_threads(1)
    for name, settings in DetectorRecipe.read().jobs().items():
        if options.only in ("", name.stem):
            pieces, path = composer(folders_of(options), settings), options.weights / name
            network = train_network(pieces, settings, options.runs / "detector" / name.stem)
            write_file(network, msgspec.to_builtins(settings), path)
            sys.stdout.write(f"{path}\n")
    return 0


def evaluate(arguments: Sequence[str]) -> int:
    """Print the model's scores on the recordings there are, or write scores.json; returns 0."""
    what = "Scores the model on people whom it never saw: on HAART's, and on further studies' where they are."
    parser = study_parser("evaluate", what, *STUDIES, "weights")
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
        sys.stdout.write(f"{write(folders_of(options), options.weights)}\n")
    else:
        show(folders_of(options), options.weights)
    return 0


def stability(arguments: Sequence[str]) -> int:
    """Check a model file's arithmetic; returns 0 when every check passed, 1 when one failed."""
    from touchd.model.studies.checks.stability import run, table

    parser = study_parser("stability", "Checks a model file's arithmetic.")
    parser.add_argument("--model", type=Path, default=SHIPPED_MODEL, help="an ONNX file; ours without it")
    parser.add_argument("--hours", type=float, default=0.0, help="also check a stream this long")
    options = parser.parse_args(arguments)
    checks = run(options.model, options.hours)
    Console().print(table(checks))
    return 0 if all(check.passed for check in checks) else 1


def _recipe_parser(name: str, description: str, *takes: str) -> argparse.ArgumentParser:
    parser = study_parser(name, description, *STUDIES, "runs", *takes)
    parser.add_argument("--recipe", type=Path, default=SHIPPED_RECIPE, help="YAML file; the shipped model's")
    return parser
