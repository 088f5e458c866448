"""Identifies the code and the data that a model was trained with."""

import hashlib
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

from touchd.drivers.recording import Recording

SOURCES = ("adapt/augment.py", "tgc.py", "settings.py")


def code_version(*more: Path) -> str:
    """Return the installed version and a digest of the sources that affect a training."""
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
