"""How long an answer takes, ours and the paper's network, in one run on one thread."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
from rich.console import Console

from docs.studies.speed import ANSWERS, run, shares, table
from model.classifier import SHIPPED_MODEL


def main(arguments: Sequence[str]) -> int:
    """Time the answers and show the table; returns 0."""
    parser = argparse.ArgumentParser(prog="speed", description="Times the classifier's answers.")
    parser.add_argument("--model", type=Path, default=SHIPPED_MODEL, help="an ONNX file; ours without it")
    parser.add_argument("--answers", type=int, default=ANSWERS, help="answers timed of each (%(default)s)")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    options = parser.parse_args(arguments)
    speeds = run(options.model, options.answers)
    compared = shares(speeds)
    if options.json:
        sys.stdout.buffer.write(msgspec.json.encode({"speeds": speeds, "shares": compared}) + b"\n")
        return 0
    console = Console()
    console.print(table(speeds))
    for share in compared:
        console.print(f"{1 / share.share:.1f} times as fast as {share.of} in {share.runtime}")
    return 0
