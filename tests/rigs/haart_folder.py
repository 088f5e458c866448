"""The folders of recordings; tests that need one are skipped when its variable is unset."""

import gzip
import os
import re
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import IO, cast

import numpy as np
import pytest

from touchd.drivers.recording import Recording, ideal_clock_ms, read_recordings
from touchd.model.training import haart

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


@cache
def haart_test_without_counts() -> list[Recording]:
    """HAART's test recordings with zeros for counts; parsing the counts takes seconds."""
    with _opened(HAART, haart.TEST_FILE) as file:
        next(file)
        frames = [(keys, len(list(rows))) for keys, rows in groupby(row.split(",", 4)[:4] for row in file)]
    return [
        Recording(*keys, np.zeros((count, 8, 8), np.uint16), ideal_clock_ms(count), "published")
        for keys, count in frames
    ]


def recordings_of(name: str, keys: str, folder: Path, study: str | None = HAART) -> Path:
    """Copy the rows of a study's file that match these keys; touchd would parse all to find them."""
    wanted = re.compile(keys).match
    with _opened(study, name) as file:
        header = next(line for line in file if not line.startswith("#"))
        copy = folder / name
        copy.write_text(header + "".join(row for row in file if wanted(row)))
    return copy


def one_person(name: str, person: str, folder: Path, study: str | None = HAART) -> list[Recording]:
    """Read one person's recordings."""
    return read_recordings(recordings_of(name, f"{person},", folder, study))


def _opened(study: str | None, name: str) -> IO[str]:
    """Open a study's file, compressed or not."""
    path = haart.find(Path(str(study)), name)
    return cast(IO[str], gzip.open(path, "rt")) if path.suffix == ".gz" else path.open()
