"""`touchd stability`: whether a model file's arithmetic holds on windows that strain it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
from rich.console import Console

from model.checks.stability import run, table
from model.classifier import SHIPPED_MODEL


def parser() -> argparse.ArgumentParser:
    """Return what the command line takes."""
    parser = argparse.ArgumentParser(prog="touchd stability", description="Checks a model file's arithmetic.")
    parser.add_argument("--model", type=Path, default=SHIPPED_MODEL, help="an ONNX file; ours without it")
    parser.add_argument("--json", action="store_true", help="one JSON array instead of a table")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Check a model file and show the table; returns 0 when every check passed, 1 when one failed."""
    options = parser().parse_args(arguments)
    checks = run(options.model)
    if options.json:
        sys.stdout.buffer.write(msgspec.json.encode(checks) + b"\n")
    else:
        Console().print(table(checks))
    return 0 if all(check.passed for check in checks) else 1
