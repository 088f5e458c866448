"""What int8 copies of the model would lose and gain, and whether to ship one."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from daemon.commands.haart_folder import add_haart_argument


def main(arguments: Sequence[str]) -> int:
    """Quantize in a temporary folder, score and time, show table and decision; returns 0."""
    parser = argparse.ArgumentParser(
        prog="python -m docs.studies quantize", description="Weighs int8 against float32."
    )
    add_haart_argument(parser)
    parser.add_argument(
        "--weights", type=Path, default=Path("model/weights"), help="folder of the model files"
    )
    options = parser.parse_args(arguments)

    from docs.studies.quantize import run, table
    from model.classifier import SHIPPED_MODEL
    from model.training import haart
    from model.training.ship import LEFT_OUT_FOLDER

    folds = sorted((options.weights / LEFT_OUT_FOLDER).glob("*.onnx"))
    variants = run(options.weights / SHIPPED_MODEL.name, folds, haart.read_training(options.haart))
    Console().print(table(variants))
    return 0
