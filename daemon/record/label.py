"""`touchd record --from-journal`: turns saved touches into recordings with the right label.

A labelled touch becomes FOLDER/participant_substrate_cover_gesture_TIME-NUMBER.csv.gz, with TIME and NUMBER
of the saved touch. FOLDER/.right holds an empty file for each touch that was answered correctly. So FOLDER
alone holds the progress, also after a crash.
"""

import argparse
import time
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import numpy as np
from rich.console import Console

from touchd.daemon.path.events import timestamp
from touchd.daemon.record.touch_picture import Offered, draw, list_touches
from touchd.daemon.record.who import Setting, ask_setting
from touchd.daemon.sinks.labels import KEYS
from touchd.daemon.sinks.touch_store import KeptTouch, folder_of, kept_touches, read_frames
from touchd.daemon.sinks.touches import read_since
from touchd.daemon.view.ask import ask
from touchd.drivers.errors import os_errors_as
from touchd.drivers.frame import DEFAULT_PAD, NO_TOUCH
from touchd.drivers.recording import (
    SUFFIX,
    Recording,
    RecordingError,
    prepare,
    read_provenance,
    write_recordings,
)

RIGHT = ".right"
NOT_KEPT = (
    "no touches are saved there; set journal.keep_touches in the daemon's configuration and restart it; "
    "it then saves new touches; if it has several pads, choose one with --pad"
)


class LabelFolder:
    """A folder of recordings made from saved touches. Raises RecordingError if it cannot be used.

    licence: what others may do with the recordings.
    """

    def __init__(self, folder: Path, licence: str) -> None:
        self.path = folder
        self._licence = licence
        prepare(folder)

    def labelled(self) -> dict[str, Path]:
        """Return the recordings by the file name of the saved touch."""
        found = [path for path in self.path.glob(f"*_*{SUFFIX}") if not path.name.startswith(".")]
        return {path.name.rpartition("_")[2]: path for path in found}

    def found_right(self) -> set[str]:
        """Return the file names of the touches marked as correct."""
        return {path.name for path in (self.path / RIGHT).glob("*")}

    def label(self, kept: KeptTouch, setting: Setting, gesture: str) -> Path:
        """Write a touch as a recording of a gesture and return its path; raises RecordingError.

        The recording spans the first to the last contact; with the label notouch, also the rest around it.
        """
        if already := self.labelled().get(kept.unlabelled_name):
            raise RecordingError(f"{already}: exists; delete it to label touch {kept.number} again")
        path = self.path / f"{'_'.join(setting)}_{gesture}_{kept.unlabelled_name}"
        frames = read_frames(kept)
        wanted = (frames.before, frames.touch, frames.after) if gesture == NO_TOUCH else (frames.touch,)
        parts = [part for part in wanted if part is not None]
        counts = np.concatenate([part.counts for part in parts])
        sensor_ms = np.concatenate([part.sensor_ms for part in parts])
        recording = Recording(*setting, gesture, counts, sensor_ms, frames.touch.framing)
        write_recordings(path, [recording], self._provenance(kept))
        return path

    def mark_right(self, kept: KeptTouch) -> None:
        """Mark the answer to a touch as correct."""
        mark = self.path / RIGHT / kept.unlabelled_name
        with os_errors_as(RecordingError, f"{mark}: cannot be written"):
            mark.parent.mkdir(exist_ok=True)
            mark.touch()

    def undo(self, kept: KeptTouch) -> None:
        """Delete a touch's recording or its mark."""
        with os_errors_as(RecordingError, f"{self.path}: cannot be changed"):
            (self.path / RIGHT / kept.unlabelled_name).unlink(missing_ok=True)
            if path := self.labelled().get(kept.unlabelled_name):
                path.unlink(missing_ok=True)

    def _provenance(self, kept: KeptTouch) -> dict[str, str]:
        return {
            **read_provenance(kept.path),
            "source": f"touchd record --from-journal, touchd {metadata.version('touchd')}",
            "labelled": timestamp(time.time()),
            "licence": self._licence,
        }


def label_of(text: str) -> tuple[str, str]:
    """Parse TOUCH=GESTURE; TOUCH is a number or the beginning of a time. For argparse."""
    touch, equals, gesture = text.rpartition("=")
    if not (touch and equals and gesture):
        raise argparse.ArgumentTypeError(f"{text!r} is not TOUCH=GESTURE, as in 17=stroke")
    return touch, gesture


def label(console: Console, options: argparse.Namespace) -> None:
    """Label the touches saved beside a journal: those of --label, or all of them in a dialogue.

    Raises RecordingError and JournalError, and `Stopped` if the person stops.
    """
    journal: Path = options.from_journal
    if len(options.gestures) > len(KEYS):
        raise RecordingError(f"--gestures: a key can name {len(KEYS)} at most; name fewer")
    pad = options.pad or DEFAULT_PAD
    kept = kept_touches(folder_of(journal, pad))
    if not kept and not journal.exists():
        raise RecordingError(f"{journal}: there is no such journal; check the path")
    if not kept:
        raise RecordingError(f"{folder_of(journal, pad)}: {NOT_KEPT}")
    folder = LabelFolder(options.folder, options.licence)
    if options.label:
        _label_named(console, folder, kept, options)
        return
    looked_at = folder.labelled().keys() | folder.found_right()
    reported = {
        (touch.began.time, touch.began.touch): touch
        for touch in read_since(journal, min(touch.time for touch in kept))
        if touch.began.pad == pad
    }
    offered = [
        Offered(touch, reported.get((touch.time, touch.number)))
        for touch in kept
        if not touch.label and touch.path.name not in looked_at
    ]
    frameless = reported.keys() - {(touch.time, touch.number) for touch in kept}
    _list(console, offered, len(kept), sum(reported[key].ended is not None for key in frameless))
    if offered:
        setting = ask_setting(console, options, past=True)
        # The latest first, as people remember it best.
        LabelDialogue(console, folder, options.gestures, setting).run(offered[::-1])


def _label_named(
    console: Console, folder: LabelFolder, kept: Sequence[KeptTouch], options: argparse.Namespace
) -> None:
    """Label the touches of --label; none of them if a touch or a gesture is wrong."""
    if options.participant is None:
        raise RecordingError("--label: name the person who touched with --participant")
    for name, gesture in options.label:
        if gesture not in options.gestures:
            known = ", ".join(options.gestures)
            raise RecordingError(f"--label {name}: {gesture} is none of --gestures, {known}")
    setting = Setting(options.participant, options.substrate or "none", options.cover or "none")
    labelled = folder.labelled()
    for touch, gesture in [(_find(kept, name), gesture) for name, gesture in options.label]:
        already = labelled.get(touch.unlabelled_name)
        if already is not None and already.name.split("_")[3] == gesture:
            console.print(f"{already.name} exists", soft_wrap=True)
        else:
            path = folder.label(touch, setting, gesture)
            console.print(f"kept {path.name}", soft_wrap=True)


def _find(kept: Sequence[KeptTouch], name: str) -> KeptTouch:
    """Return the only saved touch with this number or this beginning of a time; raises RecordingError."""
    found = [
        touch
        for touch in kept
        if (touch.number == int(name) if name.isdecimal() else touch.time.startswith(name))
    ]
    if not found:
        raise RecordingError(
            f"{name}: no saved touch has this number or time; its frames are deleted, or were never saved. "
            f"There are touches from {kept[0].time} to {kept[-1].time}"
        )
    if len(found) > 1:
        times = ", ".join(touch.time for touch in found[-3:])
        raise RecordingError(
            f"{name}: {len(found)} saved touches have it; choose one by its time, the last are {times}"
        )
    return found[0]


def _list(console: Console, offered: Sequence[Offered], kept: int, frameless: int) -> None:
    """List the touches. frameless: number of touches that only the journal has."""
    console.print(f"{kept} touches are saved; {kept - len(offered)} of them have been looked at before")
    if frameless:
        console.print(f"{frameless} more are in the journal without frames and cannot be labelled")
    if offered:
        console.print(list_touches(offered))


class LabelDialogue:
    """Asks which gesture each saved touch was."""

    def __init__(
        self, console: Console, folder: LabelFolder, gestures: Sequence[str], setting: Setting
    ) -> None:
        self._console = console
        self._print = console.print
        self._folder = folder
        self._gestures = dict(zip(KEYS, gestures, strict=False))
        self._setting = setting

    def run(self, touches: Sequence[Offered]) -> None:
        """Go through touches in order; raises `Stopped` if the person stops."""
        place = 0
        asked: list[int] = []
        while place < len(touches) or self._is_slip(asked):
            if place == len(touches):
                place = self._undo(touches, asked)
                continue
            offered = touches[place]
            try:
                frames = read_frames(offered.kept)
            except RecordingError as error:
                self._print(f"  {error}", style="yellow")
                place += 1
                continue
            title = f"{place + 1} of {len(touches)}: touch {offered.kept.number}, answered {offered.answer}"
            self._print()
            self._print(draw(offered, frames, title, self._console))
            answer = self._ask()
            if answer == "u" and asked:
                place = self._undo(touches, asked)
            elif answer == "u":
                self._print("  this is the first touch: nothing to undo", style="yellow")
            elif answer == "w":
                self._setting = ask_setting(self._console, None, self._setting, past=True)
            else:
                try:
                    self._decide(offered.kept, answer)
                    asked.append(place)
                except RecordingError as error:
                    # A running daemon deletes its oldest touches.
                    self._print(f"  not kept: {error}", style="yellow")
                place += 1

    def _is_slip(self, asked: Sequence[int]) -> bool:
        """After the last touch, ask whether to undo its answer."""
        self._print("\nThat was the last touch.", style="bold")
        return bool(asked) and ask(self._console, "Enter to end, u undo: ", ("", "u")) == "u"

    def _undo(self, touches: Sequence[Offered], asked: list[int]) -> int:
        """Undo the latest answer; returns the index of its touch."""
        place = asked.pop()
        self._folder.undo(touches[place].kept)
        self._print("  undone", style="green")
        return place

    def _decide(self, kept: KeptTouch, answer: str) -> None:
        """Carry out an answer; "l" (later) does nothing, so the next session asks again."""
        if answer == "":
            self._folder.mark_right(kept)
            self._print("  right", style="green")
        elif answer in self._gestures:
            path = self._folder.label(kept, self._setting, self._gestures[answer])
            self._print(f"  kept {path.name}", style="green")

    def _ask(self) -> str:
        setting = self._setting
        keys = "  ".join(f"{key} {gesture}" for key, gesture in self._gestures.items())
        substrate, cover = setting.substrate, setting.cover
        self._print(f"{setting.participant}, {substrate} under the pad, {cover} over it. It was:")
        self._print(keys, style="bold")
        question = "A key and Enter; only Enter: right, l later, w who or what, u undo, q quit: "
        return ask(self._console, question, (*self._gestures, "", "l", "w", "u"))
