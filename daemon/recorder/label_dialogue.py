"""Shows kept touches one by one and asks what each was."""

from collections.abc import Sequence

from rich.console import Console

from daemon.kept.touch_store import KeptTouch, read_frames
from daemon.recorder.labelling import LabelFolder
from daemon.recorder.session import Setting
from daemon.recorder.touch_picture import Offered, draw
from daemon.terminal.ask import ask, ask_setting
from drivers.recording import RecordingError

# Digits first, then letters; l, q, u and w are commands.
KEYS = "123456789abcdefghijkmnoprstvxyz"


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
