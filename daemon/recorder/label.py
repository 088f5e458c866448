"""`touchd record --from-journal`: saves what was misclassified, with the right label."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from touchd.daemon.kept.touch_store import KeptTouch, folder_of, kept_touches, read_frames
from touchd.daemon.kept.touches import read_since
from touchd.daemon.recorder.labelling import LabelFolder, find
from touchd.daemon.recorder.session import Setting
from touchd.daemon.recorder.touch_picture import Offered, draw, list_touches
from touchd.daemon.terminal.ask import ask, ask_setting
from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.recording import RecordingError

# Digits first, then letters; l, q, u and w are commands.
KEYS = "123456789abcdefghijkmnoprstvxyz"
NOT_KEPT = (
    "no frames of touches are kept there; set journal.keep_touches in the daemon's configuration, "
    "and restart it; touches from then on are kept; where it has several pads, name one with --pad"
)


def label_of(text: str) -> tuple[str, str]:
    """Return TOUCH, its number or the beginning of its time, and GESTURE of TOUCH=GESTURE; for argparse."""
    touch, equals, gesture = text.rpartition("=")
    if not (touch and equals and gesture):
        raise argparse.ArgumentTypeError(f"{text!r} is not TOUCH=GESTURE, as in 17=stroke")
    return touch, gesture


def label(console: Console, options: argparse.Namespace) -> None:
    """Label the touches kept beside a journal: those that --label names, else all, asking of each.

    Raises RecordingError and JournalError, and `Stopped` when the person wants no more.
    """
    journal: Path = options.from_journal
    if len(options.gestures) > len(KEYS):
        raise RecordingError(f"--gestures: {len(KEYS)} at most can be told apart by a key; name fewer")
    pad = options.pad or DEFAULT_PAD
    kept = kept_touches(folder_of(journal, pad))
    if not kept:
        raise RecordingError(f"{folder_of(journal, pad)}: {NOT_KEPT}")
    folder = LabelFolder(options.folder, options.licence)
    if options.label:
        _label_named(console, folder, kept, options)
        return
    looked_at = folder.labelled().keys() | folder.found_right()
    said = {
        (touch.began.time, touch.began.touch): touch
        for touch in read_since(journal, min(touch.time for touch in kept))
        if touch.began.pad == pad
    }
    offered = [
        Offered(touch, said.get((touch.time, touch.number)))
        for touch in kept
        if touch.path.name not in looked_at
    ]
    frameless = said.keys() - {(touch.time, touch.number) for touch in kept}
    _tell(console, offered, len(kept), sum(said[key].ended is not None for key in frameless))
    if offered:
        setting = ask_setting(console, options, past=True)
        # The latest first, as people remember it best.
        LabelDialogue(console, folder, options.gestures, setting).run(offered[::-1])


def _label_named(
    console: Console, folder: LabelFolder, kept: Sequence[KeptTouch], options: argparse.Namespace
) -> None:
    """Label what --label names; nothing when a name or a gesture is wrong."""
    if options.participant is None:
        raise RecordingError("--label: say with --participant who touched")
    for name, gesture in options.label:
        if gesture not in options.gestures:
            known = ", ".join(options.gestures)
            raise RecordingError(f"--label {name}: {gesture} is none of --gestures, {known}")
    setting = Setting(options.participant, options.substrate or "none", options.cover or "none")
    there = folder.labelled()
    for touch, gesture in [(find(kept, name), gesture) for name, gesture in options.label]:
        already = there.get(touch.path.name)
        if already is not None and already.name.split("_")[3] == gesture:
            console.print(f"{already.name} is there already", soft_wrap=True)
        else:
            path = folder.label(touch, setting, gesture)
            console.print(f"kept {path.name}", soft_wrap=True)


def _tell(console: Console, offered: Sequence[Offered], kept: int, frameless: int) -> None:
    """List the touches. frameless: how many more the journal has, without frames."""
    console.print(f"{kept} touches are kept; {kept - len(offered)} of them have been looked at before")
    if frameless:
        console.print(f"of {frameless} more in the journal no frames are kept, so they cannot be labelled")
    if offered:
        console.print(list_touches(offered))


class LabelDialogue:
    """Asks what each kept touch was."""

    def __init__(
        self, console: Console, folder: LabelFolder, gestures: Sequence[str], setting: Setting
    ) -> None:
        self._console = console
        self._say = console.print
        self._folder = folder
        self._gestures = dict(zip(KEYS, gestures, strict=False))
        self._setting = setting

    def run(self, touches: Sequence[Offered]) -> None:
        """Go through touches in order; raises `Stopped` when the person stops."""
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
                self._say(f"  {error}", style="yellow")
                place += 1
                continue
            title = (
                f"{place + 1} of {len(touches)}: touch {offered.kept.number}, taken for {offered.taken_for}"
            )
            self._say()
            self._say(draw(offered, frames, title, self._console))
            answer = self._ask()
            if answer == "u" and asked:
                place = self._undo(touches, asked)
            elif answer == "u":
                self._say("  this is the first: there is nothing to undo", style="yellow")
            elif answer == "w":
                self._setting = ask_setting(self._console, None, self._setting, past=True)
            else:
                try:
                    self._decide(offered.kept, answer)
                    asked.append(place)
                except RecordingError as error:
                    # A running daemon gives up its oldest touches.
                    self._say(f"  not kept: {error}", style="yellow")
                place += 1

    def _is_slip(self, asked: Sequence[int]) -> bool:
        """After the last touch, ask whether to undo its answer."""
        self._say("\nThat was the last of them.", style="bold")
        return bool(asked) and ask(self._console, "Enter to end, u undo: ", ("", "u")) == "u"

    def _undo(self, touches: Sequence[Offered], asked: list[int]) -> int:
        """Undo the latest answer; returns the index of its touch."""
        place = asked.pop()
        self._folder.undo(touches[place].kept)
        self._say("  undone", style="green")
        return place

    def _decide(self, kept: KeptTouch, answer: str) -> None:
        """Carry out an answer; "l" (later) does nothing, so the next session asks again."""
        if answer == "":
            self._folder.find_right(kept)
            self._say("  right", style="green")
        elif answer in self._gestures:
            path = self._folder.label(kept, self._setting, self._gestures[answer])
            self._say(f"  kept {path.name}", style="green")

    def _ask(self) -> str:
        setting = self._setting
        keys = "  ".join(f"{key} {gesture}" for key, gesture in self._gestures.items())
        substrate, cover = setting.substrate, setting.cover
        self._say(f"{setting.participant}, {substrate} under the pad, {cover} over it. It was:")
        self._say(keys, style="bold")
        question = "A key and Enter; only Enter: right, l later, w who or what, u undo, q quit: "
        return ask(self._console, question, (*self._gestures, "", "l", "w", "u"))
