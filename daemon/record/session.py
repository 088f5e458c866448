"""A session: which recordings to make, in which order.

Each recording is a file, FOLDER/participant_substrate_cover_gesture_number.csv.gz, in touchd's own layout;
"once-number" for a gesture made once, whose file holds the rest before and after it, too.
Files are written atomically and never overwritten, so an interrupted session can be continued.
"""

import random
from dataclasses import dataclass
from pathlib import Path

from touchd.daemon.record.who import Setting
from touchd.drivers.recording import SUFFIX, RecordingError, read_recordings


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
