"""`touchd config`: prints the example configuration, in which every setting is explained."""

import argparse
import sys
from pathlib import Path

EXAMPLE = Path(__file__).parents[1] / "touchd.example.yaml"
DESCRIPTION = (
    "Prints an example configuration with every setting, its default and what it is for. "
    "To begin with it: touchd config > touchd.yaml"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add none."""


def main(options: argparse.Namespace) -> int:
    """Print the example; returns 0."""
    sys.stdout.write(EXAMPLE.read_text(encoding="utf-8"))
    return 0
