"""The folders of recordings; tests that need one are skipped when its variable is unset."""

import gzip
import os
import re
from pathlib import Path

import pytest

HAART = os.environ.get("TOUCHD_HAART")
needs_haart = pytest.mark.skipif(HAART is None, reason="TOUCHD_HAART names no folder of HAART recordings")
SECOND_STUDY = os.environ.get("TOUCHD_SECOND_STUDY")
needs_second_study = pytest.mark.skipif(
    SECOND_STUDY is None, reason="TOUCHD_SECOND_STUDY names no folder of the second study's recordings"
)
THIRD_STUDY = os.environ.get("TOUCHD_THIRD_STUDY")
needs_third_study = pytest.mark.skipif(
    THIRD_STUDY is None, reason="TOUCHD_THIRD_STUDY names no folder of the third study's recordings"
)

# Keys of recordings on the pad without a cover.
BARE = "[^,]*,[^,]*,none,"


def recordings_of(name: str, keys: str, folder: Path) -> Path:
    """Copy the rows of a HAART file that match these keys; touchd would parse all to find them."""
    wanted = re.compile(keys).match
    with gzip.open(Path(str(HAART)) / name, "rt") as file:
        copy = folder / "haart.csv"
        copy.write_text(next(file) + "".join(row for row in file if wanted(row)))
    return copy
