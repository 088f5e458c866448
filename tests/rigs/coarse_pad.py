"""The third study's pad: 6x6, capacitive, neighbours weakly coupled; its streams as lines of text."""

import csv
import gzip
from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rigs.haart_folder import THIRD_STUDY

from touchd.drivers.search.search import Chunk

# The limits of the proof were chosen on the streams of the three others.
JUDGED_ON = ("S10", "S12", "S15", "S18")


def third_study() -> list[tuple[str, bool, NDArray[np.int_]]]:
    """Return who touched, whether they did, and (frames, clock and 36 counts) of each stream."""
    streams: dict[str, list[list[int]]] = defaultdict(list)
    keys: dict[str, tuple[str, bool]] = {}
    with gzip.open(Path(str(THIRD_STUDY)) / "streams.csv.gz", "rt") as file:
        for row in csv.DictReader(file):
            cells = (int(row[f"c{cell}"]) for cell in range(1, 37))
            streams[row["stream"]].append([int(row["ms"]), *cells])
            keys[row["stream"]] = row["participant"], row["gesture"] != "notouch"
    return [(*keys[name], np.array(rows)) for name, rows in streams.items()]


def printed(stream: NDArray[np.int_]) -> list[Chunk]:
    return [Chunk((",".join(map(str, row)) + "\r\n").encode(), row[0] / 1000) for row in stream.tolist()]
