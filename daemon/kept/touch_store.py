"""The frames of the last touches, beside the journal: a file each, whole or not at all, the oldest deleted.

JOURNAL.touches/TIME-NUMBER-COUNT.csv.gz, in our own layout, where TIME and NUMBER are those of the touch's
`touch_began` in the journal (with - for : in file names), and COUNT rises from file to file. It holds up to a
second of rest before the touch, the touch from its true first frame to its last contact, and the quiet in
which its end was known.
"""

import logging
import os
import re
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from touchd.daemon.kept.recording_file import SUFFIX, keep, prepare
from touchd.daemon.kept.touch_frames import FeltTouch, TouchPieces, cut
from touchd.drivers.errors import os_errors_as
from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.recording import UNLABELLED, Recording, RecordingError, read_recordings
from touchd.drivers.whole_file import PARTIAL

log = logging.getLogger(__name__)

FOLDER_MODE = 0o750

NAME = re.compile(r"(\d{4}-\d\d-\d\dT\d\d)-(\d\d)-(\d\d\.\d{3}Z)-(\d+)(?:-(\d+))?" + re.escape(SUFFIX))


@dataclass(frozen=True, order=True)
class KeptTouch:
    """A touch in a store. count: rises with each, whatever the clock says. time, number: of `touch_began`."""

    count: int
    time: str
    number: int
    path: Path


@dataclass(frozen=True, eq=False)
class KeptFrames:
    """What a kept touch's file holds; rest before and quiet after it may be missing."""

    before: Recording | None
    touch: Recording
    after: Recording | None


class TouchStore:
    """Writes touches to a folder, and keeps the last so many; a full disk costs touches, never the daemon.

    sensor: which pad it is and how it is read, for the files. Raises RecordingError when the folder cannot be
    used.
    """

    def __init__(self, folder: Path, most: int, sensor: str) -> None:
        self._folder = folder
        self._most = most
        self._sensor = sensor
        self._failing = False
        self.lost = 0
        with os_errors_as(RecordingError, f"{folder}: cannot be made", "give another journal.path"):
            # Like the journal, it is not world-readable.
            folder.mkdir(FOLDER_MODE, exist_ok=True)
        prepare(folder)
        self._count: int | None = None

    def add(self, touch: FeltTouch) -> None:
        """Write a touch, then delete the oldest beyond the bound; when that fails it is counted in `lost`."""
        try:
            # A user may have deleted the touches with their folder.
            self._folder.mkdir(FOLDER_MODE, exist_ok=True)
            self._count = (self._take_over() if self._count is None else self._count) + 1
            path = self._folder / file_name(touch.began.time, touch.began.touch, self._count)
            pieces = cut(touch)
            keep(path, pieces.recordings(), self._provenance(touch, pieces))
            _delete(older.path for older in kept_touches(self._folder)[: -self._most])
        except (OSError, RecordingError) as error:
            self.lost += 1
            level = logging.DEBUG if self._failing else logging.WARNING
            log.log(level, "the frames of touches are not kept until that is mended: %s", error)
            self._failing = True
        else:
            if self._failing:
                log.info("the frames of touches are kept again; those of %d were lost", self.lost)
            self._failing = False

    def _take_over(self) -> int:
        """Remove what a killed program left, and return the last count; another store wrote until now."""
        with suppress(OSError):
            _delete(self._folder.glob(f"{PARTIAL}*"))
        return max((kept.count for kept in kept_touches(self._folder)), default=0)

    def _provenance(self, touch: FeltTouch, pieces: TouchPieces) -> dict[str, str]:
        return {
            "source": f"touchd run, touchd {metadata.version('touchd')}",
            "recorded": touch.began.time,
            "touch": str(touch.began.touch),
            "taken for": f"{touch.ended.gesture} ({touch.ended.reason})",
            "sensor": self._sensor,
            "rate": pieces.rate,
            "part": "the whole touch" if pieces.is_whole else "the beginning of a longer touch",
        }


def _delete(files: Iterable[Path]) -> None:
    """Delete every file that can be deleted; then raises the OSError of the last that could not."""
    trouble: OSError | None = None
    for file in files:
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            trouble = error
    if trouble is not None:
        raise trouble


def folder_of(journal: Path, pad: str = DEFAULT_PAD) -> Path:
    """Return the folder with the frames of a journal's touches on a pad."""
    return journal.with_name(f"{journal.name}{'' if pad == DEFAULT_PAD else f'.{pad}'}.touches")


def file_name(time: str, number: int, count: int) -> str:
    return f"{time.replace(':', '-')}-{number}-{count}{SUFFIX}"


def kept_touches(folder: Path) -> list[KeptTouch]:
    """Return the touches in a store's folder, oldest first; none where there is no folder.

    Raises RecordingError when it cannot be read.
    """
    kept: list[KeptTouch] = []
    with os_errors_as(RecordingError, f"{folder}: cannot be read", "what the service keeps takes sudo"):
        try:
            with os.scandir(folder) as entries:
                names = [entry.name for entry in entries if entry.is_file(follow_symlinks=False)]
        except FileNotFoundError:
            return []
    for name in names:
        if parts := NAME.fullmatch(name):
            time = ":".join(parts.group(1, 2, 3))
            kept.append(KeptTouch(int(parts[5] or 0), time, int(parts[4]), folder / name))
    return sorted(kept)


def read_frames(kept: KeptTouch) -> KeptFrames:
    """Read a kept touch; raises RecordingError, also when it has been deleted meanwhile."""
    parts = read_recordings(kept.path)
    place = next((i for i, part in enumerate(parts) if part.gesture == UNLABELLED), None)
    if place is None:
        raise RecordingError(f"{kept.path}: holds no touch as touchd keeps them")
    before, after = parts[:place], parts[place + 1 :]
    return KeptFrames(before[-1] if before else None, parts[place], after[0] if after else None)
