"""A session: who touches what, and which recordings to make, in which order.

Each recording is a file, FOLDER/participant_substrate_cover_gesture_number.csv.gz, in touchd's own layout;
"once-number" for a gesture made once, whose file holds the rest before and after it, too.
Files are written atomically and never overwritten, so an interrupted session can be continued.
"""

import argparse
import random
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from touchd.daemon.view.terminal import Stopped, ask_line
from touchd.drivers.recording import SUFFIX, RecordingError, read_recordings

# Names become parts of file names, separated by "_", and cells of CSV files.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9-]{0,31}")
NAME_RULE = "a name has letters (a to z), digits and - only, 32 at most"


class Setting(NamedTuple):
    """Who touches what. substrate: under the pad. cover: over it."""

    participant: str = ""
    substrate: str = "none"
    cover: str = "none"


def is_name(text: str) -> bool:
    """Whether a text can name a participant, a substrate, a cover or a gesture."""
    return NAME.fullmatch(text) is not None


def name(text: str) -> str:
    """Check a name from the command line; for argparse."""
    if not is_name(text):
        raise argparse.ArgumentTypeError(f"invalid name {text!r}: {NAME_RULE}")
    return text


def ask_name(console: Console, question: str, default: str = "") -> str:
    """Return a name for a participant, a substrate or a cover; raises Stopped, as `ask` does."""
    hint = f" [{default}]" if default else ""
    while True:
        answer = ask_line(console, f"{question}{hint} ") or default
        if answer == "q":
            raise Stopped
        if is_name(answer):
            return answer
        console.print(f"  {answer!r}: {NAME_RULE}" if answer else f"  {NAME_RULE}", style="yellow")


def ask_setting(console: Console, given: object) -> Setting:
    """Return who touches what: as the options say, asking for what they leave open; raises Stopped."""
    questions = ("Who touches the pad?", "What is under the pad?", "What is over the pad?")
    options = [getattr(given, name, None) for name in Setting._fields]
    asked = zip(options, questions, Setting(), strict=True)
    return Setting(*(option or ask_name(console, question, default) for option, question, default in asked))


@dataclass(frozen=True)
class Take:
    """A recording to make: number `number` (from 1) of a gesture, and its file.

    is_single: the gesture is made once, and the rest around it is recorded too.
    """

    gesture: str
    number: int
    path: Path
    is_single: bool = False


@dataclass(frozen=True)
class Session:
    """The gestures of one setting, in rounds of random order.

    The order depends on the setting alone. singles: gestures that each round also asks for once.
    """

    folder: Path
    setting: Setting
    gestures: tuple[str, ...]
    rounds: int
    singles: tuple[str, ...] = ()

    def takes(self) -> list[Take]:
        """Return all takes in order."""
        who = "_".join(self.setting)
        takes: list[Take] = []
        for number in range(1, self.rounds + 1):
            gestures = sorted(self.gestures)
            random.Random(f"{who} {number}").shuffle(gestures)
            takes += [
                Take(gesture, number, self.folder / f"{who}_{gesture}_{number}{SUFFIX}")
                for gesture in gestures
            ]
            takes += [
                Take(gesture, number, self.folder / f"{who}_{gesture}_once-{number}{SUFFIX}", is_single=True)
                for gesture in self.singles
            ]
        return takes

    def missing(self) -> list[Take]:
        """Return the takes without a file; raises RecordingError if a file is not a recording."""
        there = [take for take in self.takes() if take.path.exists()]
        for take in there:
            try:
                is_one = bool(read_recordings(take.path))
            except RecordingError as error:
                raise RecordingError(f"{error}; repair or delete it, and record it again") from error
            if not is_one:
                raise RecordingError(f"{take.path}: holds no recording; delete it, and record it again")
        return [take for take in self.takes() if take not in there]
