"""The third study's pad: 6x6, capacitive, neighbours weakly coupled; its streams as lines of text."""

import gzip
from collections import defaultdict
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rigs.haart_folder import THIRD_STUDY

from touchd.drivers.search.listen import Chunk

# The limits of the proof were chosen on the streams of the three other people.
JUDGED_ON = ("S10", "S12", "S15", "S18")


@cache
def third_study(*who: str) -> list[tuple[str, bool, NDArray[np.int_]]]:
    """Return who touched, whether they did, and (frames, clock and 36 counts) of these people's streams."""
    streams: dict[str, list[str]] = defaultdict(list)
    keys: dict[str, tuple[str, bool]] = {}
    with gzip.open(Path(str(THIRD_STUDY)) / "streams.csv.gz", "rt") as file:
        assert next(file).startswith("stream,participant,substrate,gesture,ms,label,c1,")
        for row in file:
            stream, participant, _, gesture, at_ms, _, counts = row.rstrip().split(",", 6)
            if who and participant not in who:
                continue
            streams[stream].append(f"{at_ms},{counts}")
            keys[stream] = participant, gesture != "notouch"
    return [
        (*keys[name], np.fromstring(",".join(rows), np.int_, sep=",").reshape(len(rows), 37))
        for name, rows in streams.items()
    ]


def printed(stream: NDArray[np.int_], clock: bool = True) -> list[Chunk]:
    """Return a stream's lines, with the clock in front or the cells alone."""
    return [
        Chunk((",".join(map(str, row if clock else row[1:])) + "\r\n").encode(), row[0] / 1000)
        for row in stream.tolist()
    ]
