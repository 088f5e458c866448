"""The file of an adapted model: its name, and whether it can be written. Imports no torch, to fail early."""

import os
import re
from pathlib import Path

from touchd.drivers.errors import TouchdError

SUFFIX = ".onnx"


class OutputError(TouchdError):
    """The adapted model cannot be written; the message says why and what to do."""


def check_output(output: Path) -> None:
    """Raise OutputError unless a new .onnx file can be written there."""
    if output.suffix != SUFFIX:
        raise OutputError(f"{output}: a model's name ends with {SUFFIX}; give one with --output")
    if output.exists():
        raise OutputError(f"{output}: exists and is never overwritten; give another --output")
    if not os.access(output.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{output.parent}: nothing can be written there; give another --output")


def model_name(output: Path) -> str:
    """Return the model's name: its file's name, reduced to the characters that `Name` allows."""
    return re.sub(r"[^A-Za-z0-9_.+-]+", "-", output.stem)[:64]
