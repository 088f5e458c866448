"""Labels of kept touches: a labelled touch becomes a recording, a correct one is marked.

A recording is FOLDER/participant_substrate_cover_gesture_TIME-NUMBER.csv.gz, TIME and NUMBER being those of
the kept touch; FOLDER/.right holds an empty file for each touch whose answer was right. So FOLDER alone
records the progress, also after a crash.
"""

import time
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import numpy as np

from touchd.daemon.events import timestamp
from touchd.daemon.kept.recording_file import SUFFIX, keep, prepare
from touchd.daemon.kept.touch_store import KeptTouch, read_frames
from touchd.daemon.recorder.session import Setting
from touchd.drivers.errors import os_errors_as
from touchd.drivers.recording import NO_TOUCH, Recording, RecordingError, read_provenance

RIGHT = ".right"


class LabelFolder:
    """A folder of recordings made from kept touches. Raises RecordingError when it cannot be used.

    licence: what others may do with the recordings.
    """

    def __init__(self, folder: Path, licence: str) -> None:
        self.path = folder
        self._licence = licence
        prepare(folder)

    def labelled(self) -> dict[str, Path]:
        """Return the existing recordings by the file name of their kept touch."""
        found = [path for path in self.path.glob(f"*_*{SUFFIX}") if not path.name.startswith(".")]
        return {path.name.rpartition("_")[2]: path for path in found}

    def found_right(self) -> set[str]:
        """Return the file names of kept touches marked as right."""
        return {path.name for path in (self.path / RIGHT).glob("*")}

    def label(self, kept: KeptTouch, setting: Setting, gesture: str) -> Path:
        """Write a kept touch as a recording of a gesture, and return where; raises RecordingError.

        It spans the first to the last contact; with the label notouch, also the rest before and after.
        """
        if already := self.labelled().get(kept.path.name):
            raise RecordingError(f"{already}: is there already; delete it to label touch {kept.number} anew")
        path = self.path / f"{'_'.join(setting)}_{gesture}_{kept.path.name}"
        frames = read_frames(kept)
        wanted = (frames.before, frames.touch, frames.after) if gesture == NO_TOUCH else (frames.touch,)
        parts = [part for part in wanted if part is not None]
        counts = np.concatenate([part.counts for part in parts])
        sensor_ms = np.concatenate([part.sensor_ms for part in parts])
        recording = Recording(*setting, gesture, counts, sensor_ms, frames.touch.framing)
        keep(path, [recording], self._provenance(kept))
        return path

    def find_right(self, kept: KeptTouch) -> None:
        """Mark the answer to a touch as right."""
        mark = self.path / RIGHT / kept.path.name
        with os_errors_as(RecordingError, f"{mark}: cannot be written"):
            mark.parent.mkdir(exist_ok=True)
            mark.touch()

    def undo(self, kept: KeptTouch) -> None:
        """Undo the label of a kept touch: delete its recording or its mark."""
        with os_errors_as(RecordingError, f"{self.path}: cannot be changed"):
            (self.path / RIGHT / kept.path.name).unlink(missing_ok=True)
            if path := self.labelled().get(kept.path.name):
                path.unlink(missing_ok=True)

    def _provenance(self, kept: KeptTouch) -> dict[str, str]:
        return {
            **read_provenance(kept.path),
            "source": f"touchd record --from-journal, touchd {metadata.version('touchd')}",
            "labelled": timestamp(time.time()),
            "licence": self._licence,
        }


def find(kept: Sequence[KeptTouch], name: str) -> KeptTouch:
    """Return the one kept touch with this number or time prefix; raises RecordingError."""
    found = [
        touch
        for touch in kept
        if (touch.number == int(name) if name.isdecimal() else touch.time.startswith(name))
    ]
    if not found:
        raise RecordingError(
            f"{name}: no kept touch has this number or time; its frames are gone, or were never kept. "
            f"There are touches from {kept[0].time} to {kept[-1].time}"
        )
    if len(found) > 1:
        times = ", ".join(touch.time for touch in found[-3:])
        raise RecordingError(
            f"{name}: {len(found)} kept touches have it; say which by its time, the last are {times}"
        )
    return found[0]
