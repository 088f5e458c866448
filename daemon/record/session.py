"""A session: who touches what, and which recordings to make, in which order.

Each recording is a file, FOLDER/participant_substrate_cover_gesture_number.csv.gz, in touchd's own layout;
"once-number" for a gesture made once, whose file also holds the rest before and after it.
Files are written atomically and never overwritten, so an interrupted session can be continued.
"""

import argparse
import random
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from touchd.daemon.view.terminal import Stopped, ask_line
from touchd.drivers.recording import SUFFIX

# Names become parts of file names, separated by "_", and cells of CSV files.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9-]{0,31}")
NAME_RULE = "a name has letters (a to z), digits and - only, 32 at most"


class Setting(NamedTuple):
    """Who touches what. substrate: under the pad. cover: over it."""

    participant: str = ""
    substrate: str = "none"
    cover: str = "none"


def name(text: str) -> str:
    """Check the name of a participant, a substrate, a cover or a gesture; for argparse."""
    if not NAME.fullmatch(text):
        raise argparse.ArgumentTypeError(f"invalid name {text!r}: {NAME_RULE}")
    return text


def ask_name(console: Console, question: str, default: str = "") -> str:
    """Return a name for a participant, a substrate or a cover; raises Stopped, as `ask` does."""
    hint = f" [{default}]" if default else ""
    while True:
        answer = ask_line(console, f"{question}{hint} ") or default
        if answer == "q":
            raise Stopped
        try:
            return name(answer)
        except argparse.ArgumentTypeError as error:
            console.print(f"  {error}", style="yellow")


@dataclass(frozen=True)
class Take:
    """A recording to make. is_single: the gesture is made once, and the rest around it is recorded too."""

    gesture: str
    path: Path
    is_single: bool = False


@dataclass(frozen=True)
class Session:
    """The gestures of one setting, in rounds of random order.

    The order depends only on the setting. seconds: saved length of each recording. singles: gestures that a
    round also records once. flowing: ask only about recordings with a complaint. names: display names of
    gestures; by default as in the files.
    """

    folder: Path
    setting: Setting
    gestures: tuple[str, ...]
    rounds: int
    seconds: float
    singles: tuple[str, ...] = ()
    flowing: bool = False
    names: Mapping[str, str] = field(default_factory=dict)

    def takes(self) -> list[Take]:
        """Return all takes in order."""
        takes: list[Take] = []
        for number in range(1, self.rounds + 1):
            gestures = sorted(self.gestures)
            random.Random(f"{'_'.join(self.setting)} {number}").shuffle(gestures)
            takes += [Take(gesture, self._path(gesture, f"{number}")) for gesture in gestures]
            takes += [Take(gesture, self._path(gesture, f"once-{number}"), True) for gesture in self.singles]
        return takes

    def _path(self, gesture: str, number: str) -> Path:
        return self.folder / f"{'_'.join((*self.setting, gesture, number))}{SUFFIX}"

    def missing(self) -> list[Take]:
        """Return the takes without a file."""
        return [take for take in self.takes() if not take.path.exists()]
