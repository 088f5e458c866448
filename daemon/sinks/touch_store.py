"""Saves the frames of touches, if configured, in a folder with a limited number of files.

The files are JOURNAL.touches/TIME-NUMBER-COUNT.csv.gz, in touchd's own layout. TIME and NUMBER are those of
the touch's `touch_began` in the journal (with - for : in file names); COUNT rises from file to file. A file
holds up to a second of rest, the touch from its true first frame to its last contact, and the quiet by which
its end was detected. Labels are in the journal only. Touches without a label never displace one with a label.

The loop only appends frames. After a touch, a separate thread cuts, compresses and writes them; the next
answer is then at least a second away.
"""

import logging
import os
import re
from collections import defaultdict, deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import numpy as np
from msgspec import UNSET

from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.path.events import Event, Label, SensorEvent, TouchBegan, TouchEnded
from touchd.daemon.sinks.sink import QueuedSink
from touchd.daemon.sinks.touches import TouchKey, read_labels
from touchd.drivers.errors import os_errors_as
from touchd.drivers.faults import FaultLog
from touchd.drivers.frame import DEFAULT_PAD, FRAME_RATE_HZ, NO_TOUCH, Frame, ms_between
from touchd.drivers.pace import clock_ms
from touchd.drivers.pad.port import at_baud
from touchd.drivers.recording import KEYS, SUFFIX, UNLABELLED, Recording, RecordingError, write_recordings
from touchd.drivers.whole_file import PARTIAL

log = logging.getLogger(__name__)

FOLDER_MODE = 0o750
TOUCHES = ".touches"
NAME = re.compile(r"(\d{4}-\d\d-\d\dT\d\d)-(\d\d)-(\d\d\.\d{3}Z)-(\d+)-(\d+)" + re.escape(SUFFIX))
LEAD_MS = 1000
# Frames further apart than this are not contiguous.
CUT_MS = 1000
# A second of rest, plus the longest time until a touch is detected, for pads of up to 500 Hz.
RECENT_MS, RECENT_FRAMES = 3000, 1500
LONGEST_FRAMES = round(60.0 * FRAME_RATE_HZ)


@dataclass(frozen=True, eq=False)
class EndedTouch:
    """A touch that has ended, and the contiguous frames around it, without those of an earlier touch."""

    began: TouchBegan
    ended: TouchEnded
    frames: tuple[Frame, ...]

    def recordings(self) -> list[Recording]:
        """Return the rest before the touch, the touch, and the quiet after it if the hand left."""
        first_ms, last_ms = self.began.sensor_ms, self.ended.sensor_ms
        assert last_ms is not None, "the touch had a last contact"
        tags = {} if self.began.tags is UNSET else self.began.tags
        participant, substrate, cover = (tags.get(key, UNLABELLED) for key in KEYS[:3])
        who, is_released = (participant, substrate, cover), self.ended.reason == "released"
        return around_touch(self.frames, (first_ms, last_ms), who, UNLABELLED, is_released)


def around_touch(
    frames: Sequence[Frame],
    touch_ms: tuple[int, int],
    who: tuple[str, str, str],
    gesture: str,
    is_released: bool = True,
) -> list[Recording]:
    """Return the rest before a touch, of at most LEAD_MS, the touch itself, and the quiet if it was released.

    touch_ms: first and last contact, by the sensor's clock. who: participant, substrate and cover.
    """
    counts = np.stack([frame.pressure for frame in frames])
    clock = clock_ms(frames)
    first_ms, last_ms = (clock[0] + ms_between(frames[0].sensor_ms, ms) for ms in touch_ms)
    rest, first, after = np.searchsorted(clock, (first_ms - LEAD_MS, first_ms, last_ms + 1))
    after = max(first + 1, after)
    end = len(frames) if is_released else after
    parts = ((NO_TOUCH, rest, first), (gesture, first, after), (NO_TOUCH, after, end))
    return [
        Recording(*who, name, counts[begin:stop], clock[begin:stop], "live")
        for name, begin, stop in parts
        if begin < stop
    ]


@dataclass(frozen=True, order=True)
class SavedTouch:
    """A touch in a folder. count: rises with each touch. key: time and number of its `touch_began`."""

    count: int
    key: TouchKey
    path: Path


class TouchStore:
    """Writes touches to a folder and keeps the latest; a full disk loses touches but never stops the daemon.

    most: how many touches without a label to keep, and how many with one. sensor: describes the pad in the
    files. labelled: touches with a label. Raises RecordingError when the folder cannot be used.
    """

    def __init__(self, folder: Path, most: int, sensor: str, labelled: Iterable[TouchKey] = ()) -> None:
        self._folder = folder
        self._most = most
        self._sensor = sensor
        self._faults = FaultLog(log)
        self.lost = 0
        self._labelled = set(labelled)
        with os_errors_as(RecordingError, f"{folder}: cannot be made", "give another journal.path"):
            # Like the journal, it is not world-readable.
            folder.mkdir(FOLDER_MODE, exist_ok=True)
            # Partial files of a killed program.
            _delete(folder.glob(f"{PARTIAL}*"))
        self._count = max((touch.count for touch in saved_touches(folder)), default=0)

    def add(self, touch: EndedTouch) -> None:
        """Write a touch, then delete the oldest beyond the limit; a failure counts the touch in `lost`."""
        self._count += 1
        path = self._folder / file_name(touch.began.time, touch.began.touch, self._count)
        provenance = {
            "source": f"touchd run, touchd {metadata.version('touchd')}",
            "recorded": touch.began.time,
            "touch": str(touch.began.touch),
            "taken for": f"{touch.ended.gesture} ({touch.ended.reason})",
            "sensor": self._sensor,
        }
        try:
            # A user may have deleted the touches with their folder.
            self._folder.mkdir(FOLDER_MODE, exist_ok=True)
            write_recordings(path, touch.recordings(), provenance)
            self._delete_oldest()
        except (OSError, RecordingError) as error:
            self.lost += 1
            self._faults.begin("lost", f"the frames of touches cannot be saved: {error}", cause=str(error))
        else:
            self._faults.end("lost", f"the frames of touches are saved again; those of {self.lost} were lost")

    def label(self, label: Label) -> None:
        """Note that a touch has a label; it may not have ended yet. Thread-safe."""
        self._labelled.add((label.began, label.touch))

    def _delete_oldest(self) -> None:
        """Delete the oldest touches beyond the limit, separately for those with and without a label.

        With one limit for both, unlabelled touches would displace a person's work.
        """
        saved = saved_touches(self._folder)
        for is_labelled in (True, False):
            own = [each for each in saved if (each.key in self._labelled) == is_labelled]
            _delete(older.path for older in own[: -self._most])


def description_of(sensor: SensorSettings) -> str:
    """Describe a pad and how it is read in one line, for recordings."""
    pad = sensor.described
    return f"{pad}, crop {pad.crop}, invert {pad.invert},{at_baud(sensor.port, sensor.baud)} on {sensor.port}"


def _delete(files: Iterable[Path]) -> None:
    """Delete every file that can be deleted."""
    for file in files:
        with suppress(OSError):
            file.unlink()


def folder_of(journal: Path, pad: str = DEFAULT_PAD) -> Path:
    """Return the folder of the saved touches of a journal's pad."""
    return journal.with_name(f"{journal.name}{'' if pad == DEFAULT_PAD else f'.{pad}'}{TOUCHES}")


def file_name(time: str, number: int, count: int) -> str:
    return f"{time.replace(':', '-')}-{number}-{count}{SUFFIX}"


def saved_touches(folder: Path) -> list[SavedTouch]:
    """Return the touches in a folder, oldest first; none without the folder.

    Raises RecordingError when it cannot be read.
    """
    with os_errors_as(RecordingError, f"{folder}: cannot be read", "what the service keeps takes sudo"):
        try:
            with os.scandir(folder) as entries:
                names = [entry.name for entry in entries if entry.is_file(follow_symlinks=False)]
        except FileNotFoundError:
            return []
    found = ((folder / name, NAME.fullmatch(name)) for name in names)
    return sorted(
        SavedTouch(int(parts[5]), (":".join(parts.group(1, 2, 3)), int(parts[4])), path)
        for path, parts in found
        if parts is not None
    )


def labels_in(folder: Path) -> dict[str, str]:
    """Return the labels of the touches in a folder by file name, from the journal beside it.

    Empty for a folder of other recordings. Raises RecordingError and JournalError when something cannot be
    read.
    """
    beside = folder.absolute().with_suffix("")
    if folder.absolute().suffix != TOUCHES:
        return {}
    journal, pad = (beside, DEFAULT_PAD) if beside.exists() else (beside.with_suffix(""), beside.suffix[1:])
    labels = read_labels(journal, pad)
    return {touch.path.name: labels[touch.key] for touch in saved_touches(folder) if touch.key in labels}


class TouchSink(QueuedSink[EndedTouch]):
    """A sink that saves the frames of touches. stores: one for each pad.

    Frames and the events that they cause must come from one thread, a frame before its events. Labels may
    come from any thread, also before their touch has ended.
    """

    def __init__(self, stores: Mapping[str, TouchStore]) -> None:
        # The touches of all pads may end together.
        self.capacity = 8 * len(stores)
        super().__init__("touches")
        self._stores = stores
        self._pads: defaultdict[str, _PadFrames] = defaultdict(_PadFrames)

    def put_frame(self, frame: Frame, pad: str = DEFAULT_PAD) -> None:
        self._pads[pad].take(frame)

    def put(self, item: Event | EndedTouch) -> None:
        """Note that a touch began or has a label, or queue an ended touch for writing; returns at once."""
        match item:
            case TouchBegan():
                self._pads[item.pad].begin(item)
            case TouchEnded(sensor_ms=int(last_ms)):
                if (touch := self._pads[item.pad].end(item, last_ms)) is not None:
                    super().put(touch)
            case Label():
                self._stores[item.pad].label(item)
            case SensorEvent(state="down"):
                # The next frames are another pad's, or its clock restarted.
                self._pads.pop(item.pad, None)

    def write(self, item: EndedTouch) -> None:
        self._stores[item.began.pad].add(item)


class _PadFrames:
    """The last contiguous frames of one pad, and those of the ongoing touch."""

    def __init__(self) -> None:
        self._recent: deque[Frame] = deque(maxlen=RECENT_FRAMES)
        self._began: TouchBegan | None = None
        self._frames: list[Frame] = []
        self._is_cut = False

    def take(self, frame: Frame) -> None:
        if self._recent and not 0 <= ms_between(self._recent[-1].sensor_ms, frame.sensor_ms) <= CUT_MS:
            self._recent.clear()
            self._is_cut = True
        self._recent.append(frame)
        while ms_between(self._recent[0].sensor_ms, frame.sensor_ms) > RECENT_MS:
            self._recent.popleft()
        if self._began is not None and not self._is_cut and len(self._frames) < LONGEST_FRAMES:
            self._frames.append(frame)

    def begin(self, event: TouchBegan) -> None:
        self._began, self._frames, self._is_cut = event, list(self._recent), False

    def end(self, event: TouchEnded, last_ms: int) -> EndedTouch | None:
        """Return the touch that began; last_ms: the sensor's clock at its last contact."""
        began, frames = self._began, tuple(self._frames)
        self._began, self._frames = None, []
        # Frames of this touch must not be saved as the rest before the next one.
        while self._recent and ms_between(self._recent[0].sensor_ms, last_ms) >= 0:
            self._recent.popleft()
        return EndedTouch(began, event, frames) if began and frames else None


def touch_sink(settings: Settings, journal: Path, most: int) -> TouchSink:
    """Return the sink that saves touches beside a journal, whose folder must exist.

    most: see `TouchStore`. Raises RecordingError, and JournalError when an older journal cannot be read.
    """
    stores = {}
    for name, pad in settings.pads.items():
        sensor, labelled = description_of(pad.sensor), read_labels(journal, name)
        stores[name] = TouchStore(folder_of(journal, name), most, sensor, labelled)
    return TouchSink(stores)
