"""Saves the frames of touches, if configured, in a folder with a limited number of files.

JOURNAL.touches/TIME-NUMBER-COUNT.csv.gz, in our own layout, where TIME and NUMBER are those of the touch's
`touch_began` in the journal (with - for : in file names), and COUNT rises from file to file. A file holds up
to a second of rest, the touch from its true first frame to its last contact, and the quiet by which its end
was detected. What people said that a touch was is in the journal alone; later touches without a label do not
displace one with a label.

In the loop a frame costs two appends. A separate thread cuts, packs and writes, only after a touch, when
the next answer is a second away or more.
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
from typing import TypeAlias

import numpy as np
from msgspec import UNSET

from touchd.daemon.app.config import ConfigError, SensorSettings, Settings
from touchd.daemon.path.events import Event, Label, SensorEvent, Tags, TouchBegan, TouchEnded
from touchd.daemon.sinks.sink import QueuedSink
from touchd.daemon.sinks.touches import TouchKey, read_labels
from touchd.drivers.errors import os_errors_as
from touchd.drivers.faults import FaultLog
from touchd.drivers.frame import CLOCK_MODULUS, DEFAULT_PAD, FRAME_RATE_HZ, NO_TOUCH, Frame
from touchd.drivers.pace import clock_ms
from touchd.drivers.pad.port import at_baud
from touchd.drivers.recording import (
    KEYS,
    SUFFIX,
    UNLABELLED,
    Recording,
    RecordingError,
    prepare,
    write_recordings,
)
from touchd.drivers.whole_file import PARTIAL

log = logging.getLogger(__name__)

FOLDER_MODE = 0o750
TOUCHES = ".touches"
NAME = re.compile(r"(\d{4}-\d\d-\d\dT\d\d)-(\d\d)-(\d\d\.\d{3}Z)-(\d+)-(\d+)" + re.escape(SUFFIX))
LEAD_MS = 1000
# Frames further apart than this are not contiguous.
CUT_MS = 1000
# A second of rest plus the longest time before a touch is detected, for pads of up to 500 Hz.
RECENT_MS, RECENT_FRAMES = 3000, 1500
LONGEST_FRAMES = round(60.0 * FRAME_RATE_HZ)

# Participant, substrate and cover.
SetUp: TypeAlias = tuple[str, str, str]


@dataclass(frozen=True, eq=False)
class EndedTouch:
    """A touch that is over, and the pad's frames around it, in order of arrival.

    noticed: number of these frames that had arrived when the touch was detected. end_ms: the sensor's clock
    at its last contact. quiet_from_ms: the same of the previous touch, None if there is none.
    """

    began: TouchBegan
    ended: TouchEnded
    frames: tuple[Frame, ...]
    noticed: int
    end_ms: int
    quiet_from_ms: int | None


@dataclass(frozen=True, eq=False)
class TouchPieces:
    """The frames of a touch, and the untouched frames before and after it, which may be missing."""

    before: tuple[Frame, ...]
    touch: tuple[Frame, ...]
    after: tuple[Frame, ...]

    def recordings(self, who: SetUp) -> list[Recording]:
        """Return the pieces as recordings on one clock, the touch unlabelled. who: touches what."""
        pieces = ((NO_TOUCH, self.before), (UNLABELLED, self.touch), (NO_TOUCH, self.after))
        clocks = np.split(
            clock_ms([frame for _, piece in pieces for frame in piece]),
            np.cumsum([len(self.before), len(self.touch)]),
        )
        return [
            Recording(*who, gesture, np.stack([frame.pressure for frame in piece]), ms, "live")
            for (gesture, piece), ms in zip(pieces, clocks, strict=True)
            if piece
        ]


def cut(touch: EndedTouch) -> TouchPieces:
    """Return the touch from its true first frame to its last contact, with the rest before and after it.

    The part before lasts at most LEAD_MS and holds nothing of an earlier touch. The part after is kept only
    if the touch was released, and not if it was lost or taken for the pad's rest.
    """
    frames = touch.frames
    began_ms = touch.began.sensor_ms
    first = _walk_back(frames, touch.noticed - 1, began_ms)
    lead_ms = LEAD_MS
    if touch.quiet_from_ms is not None:
        lead_ms = min(LEAD_MS, (began_ms - touch.quiet_from_ms) % CLOCK_MODULUS - 1)
    start = _walk_back(frames, first, began_ms - lead_ms)
    stop = first + 1
    while stop < len(frames) and _is_next(frames, stop) and _is_from(touch.end_ms, frames[stop].sensor_ms):
        stop += 1
    return TouchPieces(
        before=frames[start:first],
        touch=frames[first:stop],
        after=frames[stop:] if touch.ended.reason == "released" else (),
    )


def _walk_back(frames: Sequence[Frame], place: int, until_ms: int) -> int:
    """Return the first index from which frames up to `place` are contiguous and not before `until_ms`."""
    while place > 0 and _is_next(frames, place) and _is_from(frames[place - 1].sensor_ms, until_ms):
        place -= 1
    return place


def _is_next(frames: Sequence[Frame], place: int) -> bool:
    """Whether a frame is contiguous with the one before it."""
    return (frames[place].sensor_ms - frames[place - 1].sensor_ms) % CLOCK_MODULUS <= CUT_MS


def _is_from(ms: int, since_ms: int) -> bool:
    """Whether a time is not before another, on a clock that wraps."""
    return (ms - since_ms) % CLOCK_MODULUS < CLOCK_MODULUS // 2


@dataclass(frozen=True, order=True)
class KeptTouch:
    """A touch in a store. count: rises with each touch. time, number: those of its `touch_began`."""

    count: int
    time: str
    number: int
    path: Path

    @property
    def key(self) -> TouchKey:
        return self.time, self.number


class TouchStore:
    """Writes touches to a folder and keeps the latest; a full disk loses touches, never stops the daemon.

    most: number of touches to keep, and as many with a label. sensor: describes the pad in the files.
    labelled: touches with a label. Raises RecordingError when the folder cannot be used.
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
        prepare(folder)
        self._count: int | None = None

    def add(self, touch: EndedTouch) -> None:
        """Write a touch, then delete the oldest beyond the bound; when that fails it is counted in `lost`."""
        try:
            # A user may have deleted the touches with their folder.
            self._folder.mkdir(FOLDER_MODE, exist_ok=True)
            self._count = (self._take_over() if self._count is None else self._count) + 1
            path = self._folder / file_name(touch.began.time, touch.began.touch, self._count)
            recordings = cut(touch).recordings(set_up_of(touch.began.tags))
            write_recordings(path, recordings, self._provenance(touch))
            self._delete_oldest()
        except (OSError, RecordingError) as error:
            self.lost += 1
            self._faults.begin("lost", f"the frames of touches cannot be saved: {error}", cause=str(error))
        else:
            self._faults.end("lost", f"the frames of touches are saved again; those of {self.lost} were lost")

    def label(self, label: Label) -> None:
        """Note that a touch has a label, also one that has not ended yet. Thread-safe."""
        self._labelled.add((label.began, label.touch))

    def _delete_oldest(self) -> None:
        """Delete the oldest touches beyond the bound, which holds for those with a label and those without.

        One bound for both would let touches that nobody cared about displace a person's work.
        """
        kept = kept_touches(self._folder)
        for is_labelled in (True, False):
            own = [each for each in kept if (each.key in self._labelled) == is_labelled]
            _delete(older.path for older in own[: -self._most])

    def _take_over(self) -> int:
        """Remove partial files of a killed program, and return the last count that was written here."""
        _delete(self._folder.glob(f"{PARTIAL}*"))
        return max((kept.count for kept in kept_touches(self._folder)), default=0)

    def _provenance(self, touch: EndedTouch) -> dict[str, str]:
        return {
            "source": f"touchd run, touchd {metadata.version('touchd')}",
            "recorded": touch.began.time,
            "touch": str(touch.began.touch),
            "taken for": f"{touch.ended.gesture} ({touch.ended.reason})",
            "sensor": self._sensor,
        }


def set_up_of(tags: Tags) -> SetUp:
    """Return participant, substrate and cover, as far as tags of these names say."""
    said = {} if tags is UNSET else tags
    participant, substrate, cover = (said.get(key, UNLABELLED) for key in KEYS[:3])
    return participant, substrate, cover


def description_of(sensor: SensorSettings) -> str:
    """Return a line that says which pad it is and how it is read, for recordings."""
    pad = sensor.described
    return f"{pad}, crop {pad.crop}, invert {pad.invert},{at_baud(sensor.port, sensor.baud)} on {sensor.port}"


def _delete(files: Iterable[Path]) -> None:
    """Delete every file that can be deleted."""
    for file in files:
        with suppress(OSError):
            file.unlink(missing_ok=True)


def folder_of(journal: Path, pad: str = DEFAULT_PAD) -> Path:
    """Return the folder with the frames of a journal's touches on a pad."""
    return journal.with_name(f"{journal.name}{'' if pad == DEFAULT_PAD else f'.{pad}'}{TOUCHES}")


def file_name(time: str, number: int, count: int) -> str:
    return f"{time.replace(':', '-')}-{number}-{count}{SUFFIX}"


def kept_touches(folder: Path) -> list[KeptTouch]:
    """Return the touches in a store's folder, oldest first; none where there is no folder.

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
        KeptTouch(int(parts[5]), ":".join(parts.group(1, 2, 3)), int(parts[4]), path)
        for path, parts in found
        if parts is not None
    )


def labels_in(folder: Path) -> dict[str, str]:
    """Return what people said that the touches in a store's folder were, by file name, from its journal.

    Empty for any other folder. Raises RecordingError and JournalError when something cannot be read.
    """
    beside = folder.absolute().with_suffix("")
    if folder.absolute().suffix != TOUCHES:
        return {}
    journal, pad = (beside, DEFAULT_PAD) if beside.exists() else (beside.with_suffix(""), beside.suffix[1:])
    labels = read_labels(journal, pad)
    return {kept.path.name: labels[kept.key] for kept in kept_touches(folder) if kept.key in labels}


class TouchSink(QueuedSink[EndedTouch]):
    """A sink that keeps the frames of touches on pads that have a store; it ignores other pads.

    Frames and the events that they cause must come from one thread, a frame before its events. Labels may
    come from any thread, also before their touch has ended.
    """

    capacity = 8

    def __init__(self, stores: Mapping[str, TouchStore]) -> None:
        super().__init__("touches")
        self._stores = stores
        self._pads: defaultdict[str, _PadFrames] = defaultdict(_PadFrames)

    def put_frame(self, frame: Frame, pad: str = DEFAULT_PAD) -> None:
        if pad in self._stores:
            self._pads[pad].take(frame)

    def put(self, item: Event | EndedTouch) -> None:
        """Note that a touch began or has a label, or queue an ended touch for writing; returns at once."""
        match item:
            case TouchBegan() if item.pad in self._pads:
                self._pads[item.pad].begin(item)
            case TouchEnded(sensor_ms=int(end_ms)) if item.pad in self._pads:
                touch = self._pads[item.pad].end(item, end_ms)
                if touch is not None:
                    super().put(touch)
            case Label() if item.pad in self._stores:
                self._stores[item.pad].label(item)
            case SensorEvent(state="down"):
                # The next frames are another pad's, or its clock restarted.
                self._pads.pop(item.pad, None)

    def write(self, item: EndedTouch) -> None:
        self._stores[item.began.pad].add(item)


class _PadFrames:
    """The last frames of one pad, and those of the ongoing touch."""

    def __init__(self) -> None:
        self._recent: deque[Frame] = deque(maxlen=RECENT_FRAMES)
        self._began: TouchBegan | None = None
        self._noticed = 0
        self._frames: list[Frame] = []
        self._quiet_from_ms: int | None = None

    def take(self, frame: Frame) -> None:
        self._recent.append(frame)
        while (frame.sensor_ms - self._recent[0].sensor_ms) % CLOCK_MODULUS > RECENT_MS:
            self._recent.popleft()
        if self._began is not None and len(self._frames) < LONGEST_FRAMES:
            self._frames.append(frame)

    def begin(self, event: TouchBegan) -> None:
        self._began, self._frames = event, list(self._recent)
        self._noticed = len(self._frames)

    def end(self, event: TouchEnded, end_ms: int) -> EndedTouch | None:
        began, frames, quiet_from_ms = self._began, tuple(self._frames), self._quiet_from_ms
        self._began, self._frames, self._quiet_from_ms = None, [], end_ms
        if began is None:
            return None
        return EndedTouch(began, event, frames, self._noticed, end_ms, quiet_from_ms)


def keep_touches(settings: Settings) -> TouchSink:
    """Return the sink that saves touches beside the journal, whose folder is there.

    Raises ConfigError, and JournalError when an older journal cannot be read.
    """
    journal = settings.journal
    assert journal is not None, "touches are saved beside a journal"
    assert journal.keep_touches is not None, "the journal keeps touches"
    stores = {}
    for name, pad in settings.pads.items():
        try:
            folder, what = folder_of(journal.file, name), description_of(pad.sensor)
            labelled = read_labels(journal.file, name)
            stores[name] = TouchStore(folder, journal.keep_touches, what, labelled)
        except RecordingError as error:
            raise ConfigError(f"journal.keep_touches: {error}") from error
    return TouchSink(stores)
