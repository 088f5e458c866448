"""`touchd train`: trains the networks of a recipe, or adapts the shipped one; needs the extra `train`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from daemon.commands.haart_folder import add_haart_argument, add_second_study_argument, default_haart


def parser() -> argparse.ArgumentParser:
    """Return what the command line takes."""
    parser = argparse.ArgumentParser(
        prog="touchd train",
        description="Trains every network of a recipe. Run it again to go on after an interruption. With "
        "--extra it adapts the shipped model to recordings of your own instead, in about a minute, and says "
        "how well it does before and after.",
    )
    add_haart_argument(parser)
    add_second_study_argument(parser)
    parser.set_defaults(haart=None)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder for checkpoints (runs)")
    parser.add_argument("--recipe", type=Path, help="YAML file; the recipe of the shipped model without it")
    parser.add_argument("--threads", type=int, default=2, help="processor threads, where there is no GPU (2)")
    adapting = parser.add_argument_group(
        "to adapt", "With --haart, HAART's recordings are rehearsed, so that nothing is forgotten for yours."
    )
    adapting.add_argument(
        "--extra", type=Path, metavar="FOLDER", help="recordings of your own, as `touchd record` makes them"
    )
    adapting.add_argument(
        "--output", type=Path, metavar="ONNX", help="the new model's file; touchd-FOLDER.onnx without it"
    )
    adapting.add_argument("--seed", type=int, default=0, help="other random choices (%(default)s)")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Train what is not trained yet, resuming where a training was cut off, or adapt; returns 0."""
    options = parser().parse_args(arguments)
    if options.extra is None and options.output is not None:
        parser().error("--output is for --extra; `touchd export` writes what a recipe has trained")
    if options.extra is not None and options.recipe is not None:
        parser().error("--recipe is not for --extra, which adapts the shipped model")
    # Before anything is read: all that follows takes torch.
    import torch  # noqa: F401

    return _adapt(options) if options.extra is not None else _train(options, options.haart or default_haart())


def _train(options: argparse.Namespace, haart: Path) -> int:
    from model.training.recipe import SHIPPED_RECIPE, read_recipe
    from model.training.ship import train_recipe
    from model.training.studies import Folders

    folders = Folders(haart, options.second_study)
    train_recipe(read_recipe(options.recipe or SHIPPED_RECIPE), folders, options.runs, options.threads)
    return 0


def _adapt(options: argparse.Namespace) -> int:
    from model.adapt.head import AdaptSettings
    from model.adapt.report import report_lines
    from model.adapt.ship import adapt_folder

    output = options.output or Path(f"touchd-{options.extra.resolve().name}.onnx")
    settings = AdaptSettings(seed=options.seed)
    adapted = adapt_folder(options.extra, options.haart, output, settings)
    for line in report_lines(adapted):
        sys.stdout.write(f"{line}\n")
    sys.stdout.write(f"\nWritten: {output}. To use it, set `model: {output.resolve()}` in touchd.yaml.\n")
    return 0
