"""A session of recordings: what to record in which order, a file each.

One file a recording, FOLDER/participant_substrate_cover_gesture_number.csv.gz, in our own layout with its
provenance. Files are written whole and never overwritten, so an interrupted session can be continued.
"""

import argparse
import random
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from touchd.daemon.kept.recording_file import SUFFIX
from touchd.drivers.recording import RecordingError, read_recordings

# Names are parts of file names, separated by "_", and cells of a CSV file.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9-]{0,31}")
NAME_RULE = "a name has letters, digits and - only, 32 at most"


@dataclass(frozen=True)
class Take:
    """A recording to make: the `number`-th (from 1) of a gesture, and its file."""

    gesture: str
    number: int
    path: Path


class Setting(NamedTuple):
    """Who touches what. substrate: under the pad. cover: over it."""

    participant: str = ""
    substrate: str = "none"
    cover: str = "none"


@dataclass(frozen=True)
class Session:
    """Who does which gestures on what, in how many rounds, each in a random order.

    The order depends only on seed and setting.
    """

    folder: Path
    setting: Setting
    gestures: tuple[str, ...]
    rounds: int
    seed: int

    def takes(self) -> list[Take]:
        """Return all recordings of the session in order."""
        who = "_".join(self.setting)
        takes: list[Take] = []
        for number in range(1, self.rounds + 1):
            gestures = sorted(self.gestures)
            random.Random(f"{self.seed} {who} {number}").shuffle(gestures)
            takes += [
                Take(gesture, number, self.folder / f"{who}_{gesture}_{number}{SUFFIX}")
                for gesture in gestures
            ]
        return takes

    def missing(self) -> list[Take]:
        """Return the recordings still to make; raises RecordingError where a file of one's name is none."""
        there = [take for take in self.takes() if take.path.exists()]
        for take in there:
            try:
                is_one = bool(read_recordings(take.path))
            except RecordingError as error:
                raise RecordingError(f"{error}; mend or delete it, and record it again") from error
            if not is_one:
                raise RecordingError(f"{take.path}: holds no recording; delete it, and record it again")
        return [take for take in self.takes() if take not in there]


def is_name(text: str) -> bool:
    """Return whether a text can name a participant, a substrate, a cover or a gesture."""
    return NAME.fullmatch(text) is not None


def name(text: str) -> str:
    """Return a name given on the command line; for argparse."""
    if not is_name(text):
        raise argparse.ArgumentTypeError(f"{text!r} is no name: {NAME_RULE}")
    return text
