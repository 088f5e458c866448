"""`touchd config`: prints the example configuration, in which every setting is explained."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

EXAMPLE = Path(__file__).parents[1] / "touchd.example.yaml"


def parser() -> argparse.ArgumentParser:
    return argparse.ArgumentParser(
        prog="touchd config",
        description="Prints an example configuration with every setting, its default and what it is for. "
        "To begin with it: touchd config > touchd.yaml",
    )


def main(arguments: Sequence[str]) -> int:
    """Print the example; returns 0."""
    parser().parse_args(arguments)
    sys.stdout.write(EXAMPLE.read_text(encoding="utf-8"))
    return 0
