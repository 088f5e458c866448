"""Guides a person through a session: records each gesture, checks it, keeps it."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from typing import Literal

from rich.console import Console

from touchd.daemon.config import Settings
from touchd.daemon.events import timestamp
from touchd.daemon.kept.recording_file import keep
from touchd.daemon.recorder.capture import Capture, Contact, PadLost, PadReader, complaints
from touchd.daemon.recorder.progress import progress
from touchd.daemon.recorder.session import Session, Take
from touchd.daemon.setup.destinations import description_of
from touchd.daemon.terminal.ask import ask
from touchd.drivers.pad.pace import pace_of
from touchd.drivers.recording import RecordingError

# As in HAART: of ten seconds of a repeated gesture, keep the middle eight.
EDGE_S = 1.0
# A board may restart when its port is opened, which takes two seconds.
ALIVE_WITHIN_S = 5.0

HOW = {
    "constant": "lay a hand on the pad and leave it there",
    "notouch": "leave the pad alone",
    "pat": "pat the pad with a flat hand, again and again",
    "rub": "rub the pad to and fro, without lifting the hand",
    "scratch": "scratch the pad with the fingertips, again and again",
    "stroke": "stroke the pad with a flat hand one way, lift, and again",
    "tickle": "tickle the pad with light, quick fingers",
}

Choice = Literal["keep", "redo", "skip"]


@dataclass(frozen=True)
class Terms:
    """Settings of every recording.

    seconds: length that is kept. countdown_s: how long the pad rests before. licence: what others may do.
    flowing: ask only about recordings that look wrong.
    """

    seconds: float
    countdown_s: float
    licence: str
    flowing: bool = False


class Dialogue:
    """Asks for every recording of a session that is still missing."""

    def __init__(
        self, console: Console, pad: PadReader, settings: Settings, session: Session, terms: Terms
    ) -> None:
        self._console = console
        self._say = console.print
        self._ask = partial(ask, console)
        self._pad = pad
        self._settings = settings
        self._session = session
        self._terms = terms
        self._waits = True

    def run(self) -> None:
        """Record what is missing; raises `Stopped` when the person stops."""
        takes, missing = self._session.takes(), self._session.missing()
        for place, take in enumerate(takes, 1):
            if take in missing:
                how = HOW.get(take.gesture, f"{take.gesture}, again and again")
                self._say(f"\n{place} of {len(takes)}: {take.gesture}", style="bold")
                self._say(f"  {how}, until the bar is full")
                self._make(take)
        there = sum(take.path.exists() for take in takes)
        self._say(f"\n{there} of {len(takes)} recordings are in {self._session.folder}", style="bold")
        if there < len(takes):
            self._say("The same command asks for the others again.")

    def _make(self, take: Take) -> None:
        """Record until a take is kept or skipped."""
        choice: Choice = "redo"
        while choice == "redo":
            if self._waits and self._ask("  Enter to begin, s to skip, q to stop: ", ("", "s")) == "s":
                return
            self._waits = not self._terms.flowing
            try:
                capture = self._capture(take)
            except PadLost as lost:
                self._say(f"  {lost}", style="yellow")
                self._waits = True
                continue
            choice = self._choose(capture, take)
            if choice == "keep":
                self._keep(take, capture)

    def _keep(self, take: Take, capture: Capture) -> None:
        """Keep a recording, as soon as it can be: the disk may be full. Raises `Stopped`."""
        recording = capture.recording(self._session.setting, take.gesture)
        while True:
            try:
                keep(take.path, [recording], self._provenance(take, capture))
            except RecordingError as error:
                self._say(f"  not kept yet: {error}", style="yellow")
                if self._ask("  Enter to try again, s to skip it, q to stop: ", ("", "s")) == "s":
                    return
            else:
                self._say(f"  kept {take.path.name}", style="green")
                return

    def _capture(self, take: Take) -> Capture:
        """Count down while the pad rests, then record; raises PadLost."""
        if reason := self._pad.await_frame(ALIVE_WITHIN_S):
            raise PadLost(reason)
        contact = Contact(self._settings)
        countdown_s = self._terms.countdown_s
        length_s = self._terms.seconds + 2 * EDGE_S
        frames, touched = [], 0
        with progress(self._console) as show:
            for elapsed_s, frame in self._pad.follow(countdown_s):
                contact.update(frame)
                show("hands off", elapsed_s, countdown_s, frame.pressure)
            # For people who look at their hand, not at the screen.
            self._console.bell()
            for elapsed_s, frame in self._pad.follow(length_s):
                is_touched = contact.update(frame)
                show(f"{take.gesture} now", elapsed_s, length_s, frame.pressure)
                if EDGE_S <= elapsed_s < length_s - EDGE_S:
                    frames.append(frame)
                    touched += is_touched
        self._console.bell()
        return Capture(tuple(frames), touched / len(frames))

    def _choose(self, capture: Capture, take: Take) -> Choice:
        """Show what was recorded and ask what to do with it."""
        peak = max(int(frame.pressure.max()) for frame in capture.frames)
        pace = pace_of(capture.frames)
        self._say(
            f"  {len(capture.frames)} frames, {pace.rate_hz:.1f} a second, peak {peak} counts, "
            f"touched {capture.touched_share:.0%} of the time"
        )
        found = complaints(capture, take.gesture, self._pad.troubles)
        if not found and self._terms.flowing:
            return "keep"
        if not found:
            question = "  Enter to keep it, r to do it again, s to skip, q to stop: "
            choices: Mapping[str, Choice] = {"": "keep", "r": "redo", "s": "skip"}
        else:
            for complaint in found:
                self._say(f"  {complaint}", style="yellow")
            question = "  Enter to do it again, k to keep it all the same, s to skip, q to stop: "
            choices = {"": "redo", "k": "keep", "s": "skip"}
        return choices[self._ask(question, choices)]

    def _provenance(self, take: Take, capture: Capture) -> dict[str, str]:
        return {
            "source": f"touchd record, touchd {metadata.version('touchd')}",
            "recorded": timestamp(time.time()),
            "sensor": description_of(self._settings.sensor),
            "rate": str(pace_of(capture.frames)),
            "part": f"the middle {self._terms.seconds:g} s of {self._terms.seconds + 2 * EDGE_S:g} s",
            "round": f"{take.number} of {self._session.rounds}, seed {self._session.seed}",
            "licence": self._terms.licence,
        }
