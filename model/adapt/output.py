"""The file of a trained model: its name, whether it can be written, and what it was trained with.

Imports no torch, so that a command can refuse an output at once.
"""

import hashlib
import os
import re
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

from touchd.drivers.errors import TouchdError
from touchd.drivers.recording import Recording

SUFFIX = ".onnx"
# The sources that decide any training's result.
SOURCES = ("adapt/augment.py", "adapt/optimise.py", "tgc.py", "settings.py")


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


def code_version(*more: Path) -> str:
    """Return the installed version and a digest of the sources. more: further sources of a training."""
    digest = hashlib.sha256()
    for path in (*(Path(__file__).parents[1] / name for name in SOURCES), *more):
        digest.update(path.read_bytes())
    return f"{metadata.version('touchd')}+{digest.hexdigest()[:12]}"


def data_hash(recordings: Iterable[Recording]) -> str:
    """Return the SHA-256 of all counts (int16, little-endian, in order)."""
    digest = hashlib.sha256()
    for recording in recordings:
        digest.update(recording.counts.astype("<i2").tobytes())
    return digest.hexdigest()
