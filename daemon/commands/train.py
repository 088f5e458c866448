"""`touchd train`: trains the networks of a recipe; needs the extra `train`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from daemon.commands.haart_folder import add_haart_argument


def main(arguments: Sequence[str]) -> int:
    """Train what is not trained yet, resuming where a training was cut off; returns 0."""
    parser = argparse.ArgumentParser(
        prog="touchd train",
        description="Trains every network of a recipe. Run it again to go on after an interruption.",
    )
    add_haart_argument(parser)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder for checkpoints (runs)")
    parser.add_argument("--recipe", type=Path, help="YAML file; the recipe of the shipped model without it")
    parser.add_argument("--threads", type=int, default=2, help="processor threads, where there is no GPU (2)")
    options = parser.parse_args(arguments)

    from model.recipe import SHIPPED_RECIPE, read_recipe
    from model.ship import train_recipe

    train_recipe(read_recipe(options.recipe or SHIPPED_RECIPE), options.haart, options.runs, options.threads)
    return 0
