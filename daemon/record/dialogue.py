"""Guides a person through a session: records each gesture, checks the recording, saves it."""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from importlib import metadata
from typing import Literal, TypeAlias

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from touchd.daemon.app.config import Settings
from touchd.daemon.path.events import timestamp
from touchd.daemon.record.capture import (
    SINGLE_WITHIN_S,
    Capture,
    Contact,
    PadLost,
    PadReader,
    complaints,
)
from touchd.daemon.record.session import Session, Take
from touchd.daemon.sinks.touch_store import description_of
from touchd.daemon.view.elements import big
from touchd.daemon.view.pad_picture import pad_picture
from touchd.daemon.view.terminal import Stopped, ask, listening
from touchd.drivers.frame import COLUMNS, NO_TOUCH, OTHER, ROWS, Counts, Frame
from touchd.drivers.pace import pace_of
from touchd.drivers.recording import RecordingError, write_recordings

# Trim both ends, as HAART does: it keeps the middle eight of ten seconds.
EDGE_S = 1.0
# Opening the port may restart the board, which takes two seconds.
ALIVE_WITHIN_S = 5.0

HOW = {
    "constant": "lay a hand on the pad and leave it there",
    "notouch": "leave the pad alone",
    "pat": "pat the pad with a flat hand, again and again",
    "rub": "rub the pad to and fro, without lifting the hand",
    "scratch": "scratch the pad with the fingertips, again and again",
    "stroke": "stroke the pad with a flat hand one way, lift, and again",
    "tickle": "tickle the pad with light, quick fingers",
    OTHER: "touch the pad in every other way: poke, pinch, squeeze, twist, drum, knock",
}

# What a session records unless it is asked for OTHER, too.
GESTURES = tuple(gesture for gesture in HOW if gesture != OTHER)
HOW_ONCE = {"pat": "pat the pad once with a flat hand", "stroke": "stroke the pad once, one way"}

HANDS_OFF = "hands off"
QUIT = "q"
REFRESH_HZ = 12
PAD_SCALE = 2
WIDTH = 56
GAP = 2
# Noise above the lowest reading of a taxel.
NOISE_COUNTS = 6.0

# Called with the current step, the elapsed and total seconds, and the counts.
Show: TypeAlias = Callable[[str, float, float, Counts], None]
Choice = Literal["keep", "redo", "skip"]


@dataclass(frozen=True)
class Terms:
    """Settings of all recordings of a session.

    seconds: length that is saved. countdown_s: rest before each recording. licence: what others may do.
    flowing: ask only about recordings with a complaint. names: what gestures are called; by default as in
    the files.
    """

    seconds: float
    countdown_s: float
    licence: str
    flowing: bool = False
    names: Mapping[str, str] = field(default_factory=dict)


class Dialogue:
    """Asks for each missing recording of a session."""

    def __init__(
        self, console: Console, pad: PadReader, settings: Settings, session: Session, terms: Terms
    ) -> None:
        self._console = console
        self._print = console.print
        self._ask = partial(ask, console)
        self._pad = pad
        self._settings = settings
        self._session = session
        self._terms = terms
        self._waits = True
        self._must_quit = False

    def run(self) -> None:
        """Record what is missing; raises `Stopped` if the person stops."""
        takes, missing = self._session.takes(), self._session.missing()
        for place, take in enumerate(takes, 1):
            if take in missing:
                name = self._name(take)
                self._print(f"\n{place} of {len(takes)}: {name}", style="bold")
                if take.is_single:
                    self._print(f"  {HOW_ONCE.get(take.gesture, take.gesture)}, then leave it alone")
                else:
                    how = HOW.get(take.gesture, f"{take.gesture}, again and again")
                    self._print(f"  {how}, until the bar is full")
                self._make(take)
        there = sum(take.path.exists() for take in takes)
        self._print(f"\n{there} of {len(takes)} recordings are in {self._session.folder}", style="bold")
        if there < len(takes):
            self._print("Run the same command again to record the others.")

    def _name(self, take: Take) -> str:
        name = self._terms.names.get(take.gesture, take.gesture)
        return f"{name}, once" if take.is_single else name

    def _make(self, take: Take) -> None:
        """Record until a take is saved or skipped."""
        choice: Choice = "redo"
        while choice == "redo":
            if self._waits and self._ask("  Enter to begin, s to skip, q to stop: ", ("", "s")) == "s":
                return
            self._waits = not self._terms.flowing
            try:
                capture = self._capture(take)
            except PadLost as lost:
                self._print(f"  {lost}", style="yellow")
                self._waits = True
                continue
            choice = self._choose(capture, take)
            if choice == "keep":
                self._keep(take, capture)

    def _keep(self, take: Take, capture: Capture) -> None:
        """Save a recording; if that fails, as on a full disk, ask to try again. Raises `Stopped`."""
        recordings = capture.recordings(self._session.setting, take.gesture)
        while True:
            try:
                write_recordings(take.path, recordings, self._provenance(take, capture))
            except RecordingError as error:
                self._print(f"  not kept yet: {error}", style="yellow")
                if self._ask("  Enter to try again, s to skip it, q to stop: ", ("", "s")) == "s":
                    return
            else:
                self._print(f"  kept {take.path.name}", style="green")
                return

    @contextmanager
    def _may_quit(self) -> Iterator[None]:
        """Let q end a recording, which is then not kept; raises `Stopped`."""
        self._must_quit = False

        def on_key(key: str) -> None:
            self._must_quit |= key.lower() == QUIT

        with listening(on_key):
            yield

    def _follow(self, seconds: float) -> Iterator[tuple[float, Frame]]:
        """Yield (seconds since the first frame, frame); raises PadLost, and `Stopped` if the person quits."""
        for elapsed_s, frame in self._pad.follow(seconds):
            if self._must_quit:
                raise Stopped
            yield elapsed_s, frame

    def _countdown(self, contact: Contact, show: Show) -> list[Frame]:
        """Follow the pad at rest until the gesture is due; return its frames."""
        frames = []
        for elapsed_s, frame in self._follow(self._terms.countdown_s):
            contact.update(frame)
            show(HANDS_OFF, elapsed_s, self._terms.countdown_s, frame.pressure)
            frames.append(frame)
        # For people who look at their hand rather than the screen.
        self._console.bell()
        return frames

    def _capture(self, take: Take) -> Capture:
        """Count down while the pad rests, then record; raises PadLost and `Stopped`."""
        if reason := self._pad.await_frame(ALIVE_WITHIN_S):
            raise PadLost(reason)
        contact = Contact(self._settings)
        with self._may_quit(), progress(self._console) as show:
            rest = self._countdown(contact, show)
            capture = (
                self._once(take, contact, show, rest) if take.is_single else self._long(take, contact, show)
            )
        self._console.bell()
        return capture

    def _once(self, take: Take, contact: Contact, show: Show, frames: list[Frame]) -> Capture:
        """Record until a touch has begun and ended. frames: the rest before it."""
        # One that was over before it was asked for.
        contact.touch = None
        for elapsed_s, frame in self._follow(SINGLE_WITHIN_S):
            frames.append(frame)
            contact.update(frame)
            show(self._name(take), elapsed_s, SINGLE_WITHIN_S, frame.pressure)
            if contact.touch is not None:
                break
        return Capture(tuple(frames), touch=contact.touch)

    def _long(self, take: Take, contact: Contact, show: Show) -> Capture:
        """Record for the time of the terms, and a second before and after, which is not saved."""
        length_s = self._terms.seconds + 2 * EDGE_S
        frames, touched = [], 0
        # A name of another language stands alone.
        step = f"{take.gesture} now" if not self._terms.names else self._name(take)
        step = HANDS_OFF if take.gesture == NO_TOUCH else step
        for elapsed_s, frame in self._follow(length_s):
            is_touched = contact.update(frame)
            kept_s = min(max(elapsed_s - EDGE_S, 0.0), self._terms.seconds)
            show(step, kept_s, self._terms.seconds, frame.pressure)
            if EDGE_S <= elapsed_s < length_s - EDGE_S:
                frames.append(frame)
                touched += is_touched
        return Capture(tuple(frames), touched / len(frames))

    def _choose(self, capture: Capture, take: Take) -> Choice:
        """Summarise a recording and ask what to do with it."""
        peak = max(int(frame.pressure.max()) for frame in capture.frames)
        rate_hz = pace_of(capture.frames).rate_hz
        touched = f"{capture.touched_share:.0%} of the time"
        touched = f"for {capture.length_s:.1f} s" if take.is_single else touched
        self._print(
            f"  {len(capture.frames)} frames, {rate_hz:.1f} a second, peak {peak} counts, touched {touched}"
        )
        found = complaints(capture, take.gesture, self._pad.troubles, is_single=take.is_single)
        if not found and self._terms.flowing:
            return "keep"
        for complaint in found:
            self._print(f"  {complaint}", style="yellow")
        if take.is_single and capture.touch is None:
            question = "  Enter to do it again, s to skip, q to stop: "
            choices: Mapping[str, Choice] = {"": "redo", "s": "skip"}
        elif found:
            question = "  Enter to do it again, k to keep it all the same, s to skip, q to stop: "
            choices = {"": "redo", "k": "keep", "s": "skip"}
        else:
            question = "  Enter to keep it, r to do it again, s to skip, q to stop: "
            choices = {"": "keep", "r": "redo", "s": "skip"}
        return choices[self._ask(question, choices)]

    def _provenance(self, take: Take, capture: Capture) -> dict[str, str]:
        part = f"the middle {self._terms.seconds:g} s of {self._terms.seconds + 2 * EDGE_S:g} s"
        return {
            "source": f"touchd record, touchd {metadata.version('touchd')}",
            "recorded": timestamp(time.time()),
            "sensor": description_of(self._settings.sensor),
            "rate": str(pace_of(capture.frames)),
            "part": "one touch, with the rest around it" if take.is_single else part,
            "round": f"{take.number} of {self._session.rounds}",
            "licence": self._terms.licence,
        }


@contextmanager
def progress(console: Console) -> Iterator[Show]:
    """Draw the pad and the progress, and erase them at the end; draws nothing without a terminal."""
    rest = np.full((ROWS, COLUMNS), np.inf)
    shown = ("", 0.0, 1.0, np.zeros((ROWS, COLUMNS)))

    def show(step: str, elapsed_s: float, length_s: float, pressure: Counts) -> None:
        nonlocal shown
        np.minimum(rest, pressure, out=rest)
        shown = step, elapsed_s, length_s, np.maximum(pressure - rest - NOISE_COUNTS, 0.0)

    def draw() -> Table:
        step, elapsed_s, length_s, pressure = shown
        width = min(WIDTH, console.width - COLUMNS * PAD_SCALE - GAP)
        words = [Text(line, style="bold") for line in big(step, width)]
        left = Text(f"{step}, {math.ceil(length_s - elapsed_s)} s")
        bar = ProgressBar(total=length_s, completed=elapsed_s, width=width)
        grid = Table.grid(padding=(1, GAP))
        grid.add_row(Group(*pad_picture(pressure, PAD_SCALE, console)), Group(*words, "", left, bar))
        return grid

    with Live(get_renderable=draw, console=console, transient=True, refresh_per_second=REFRESH_HZ):
        yield show
