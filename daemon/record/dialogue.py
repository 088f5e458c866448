"""Guides a person through a session: records each gesture, checks and saves the recording."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib import metadata
from typing import TypeAlias

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from touchd.daemon.path.events import timestamp
from touchd.daemon.record.capture import SINGLE_WITHIN_S, Capture, PadLost, PadReader, complaints
from touchd.daemon.record.session import Session, Take
from touchd.daemon.sinks.touch_store import description_of
from touchd.daemon.view.elements import big, pad_picture
from touchd.daemon.view.terminal import Stopped, ask, listening
from touchd.drivers.frame import COLUMNS, NO_TOUCH, OTHER, ROWS, Counts, Frame
from touchd.drivers.pace import pace_of
from touchd.drivers.recording import RecordingError, write_recordings

# Rest before each recording.
COUNTDOWN_S = 2.0
# Cut from both ends, as in HAART, which keeps the middle eight of ten seconds.
EDGE_S = 1.0

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

# The gestures of a session; OTHER is recorded on request.
GESTURES = tuple(gesture for gesture in HOW if gesture != OTHER)
HOW_ONCE = {"pat": "pat the pad once with a flat hand", "stroke": "stroke the pad once, one way"}

HANDS_OFF = "hands off"
QUIT = "q"
REFRESH_HZ = 12
WIDTH, GAP, PAD_SCALE = 56, 2, 2
# Noise above the lowest reading of a taxel.
NOISE_COUNTS = 6.0

# Called with the current step, the elapsed and total seconds, and the counts.
Show: TypeAlias = Callable[[str, float, float, Counts], None]


class Dialogue:
    """Asks for each missing recording of a session."""

    def __init__(self, console: Console, pad: PadReader, session: Session) -> None:
        self._console = console
        self._print = console.print
        self._ask = partial(ask, console)
        self._pad = pad
        self._session = session
        self._waits = True

    def run(self) -> None:
        """Record what is missing; raises `Stopped` if the person stops."""
        takes, missing = self._session.takes(), self._session.missing()
        for place, take in enumerate(takes, 1):
            if take in missing:
                self._print(f"\n{place} of {len(takes)}: {self._name(take)}", style="bold")
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
        name = self._session.names.get(take.gesture, take.gesture)
        return f"{name}, once" if take.is_single else name

    def _make(self, take: Take) -> None:
        """Record until a take is saved or skipped; raises `Stopped`."""
        while True:
            if self._waits and self._ask("  Enter to begin, s to skip, q to stop: ", ("", "s")) == "s":
                return
            self._waits = not self._session.flowing
            try:
                capture = self._capture(take)
            except PadLost as lost:
                self._print(f"  {lost}", style="yellow")
                self._waits = True
                continue
            choice = self._choose(capture, take)
            if choice == "keep":
                self._keep(take, capture)
            if choice != "redo":
                return

    def _keep(self, take: Take, capture: Capture) -> None:
        """Save a recording; if that fails, as on a full disk, ask to try again. Raises `Stopped`."""
        recordings = capture.recordings(self._session.setting, take.gesture)
        while True:
            try:
                write_recordings(take.path, recordings, self._provenance(capture))
            except RecordingError as error:
                self._print(f"  not kept yet: {error}", style="yellow")
                if self._ask("  Enter to try again, s to skip it, q to stop: ", ("", "s")) == "s":
                    return
            else:
                self._print(f"  kept {take.path.name}", style="green")
                return

    def _capture(self, take: Take) -> Capture:
        """Count down while the pad rests, then record; raises PadLost and `Stopped`."""
        contact = self._pad.contact()
        keys: list[str] = []
        with listening(keys.append), progress(self._console) as show:

            def follow(step: str, seconds: float) -> Iterator[tuple[float, Frame]]:
                """Yield (seconds since the first frame, frame) until the time is over."""
                for elapsed_s, frame in self._pad.follow(seconds):
                    if QUIT in map(str.lower, keys):
                        raise Stopped
                    contact.update(frame)
                    show(step, elapsed_s, seconds, frame.pressure)
                    yield elapsed_s, frame

            frames = [frame for _, frame in follow(HANDS_OFF, COUNTDOWN_S)]
            # For people who look at their hand rather than the screen.
            self._console.bell()
            if take.is_single:
                # Ignore a touch that ended before it was asked for.
                contact.touch = None
                for _, frame in follow(self._name(take), SINGLE_WITHIN_S):
                    frames.append(frame)
                    if contact.touch is not None:
                        break
                capture = Capture(tuple(frames), touch=contact.touch)
            else:
                stop_s = EDGE_S + self._session.seconds
                middle = [
                    (frame, contact.is_touched)
                    for elapsed_s, frame in follow(self._step(take), stop_s + EDGE_S)
                    if EDGE_S <= elapsed_s < stop_s
                ]
                saved, touched = zip(*middle, strict=True)
                capture = Capture(saved, sum(touched) / len(touched))
        self._console.bell()
        return capture

    def _step(self, take: Take) -> str:
        """Return what to do now; a name in another language stands alone."""
        if take.gesture == NO_TOUCH:
            return HANDS_OFF
        return self._name(take) if self._session.names else f"{take.gesture} now"

    def _choose(self, capture: Capture, take: Take) -> str:
        """Summarise a recording and ask what to do with it: keep, redo or skip."""
        peak = max(int(frame.pressure.max()) for frame in capture.frames)
        rate_hz = pace_of(capture.frames).rate_hz
        touched = f"{capture.touched_share:.0%} of the time"
        if take.is_single:
            touched = f"for {capture.length_s:.1f} s"
        self._print(
            f"  {len(capture.frames)} frames, {rate_hz:.1f} a second, peak {peak} counts, touched {touched}"
        )
        found = complaints(capture, take, self._pad.taxels.found.values())
        if not found and self._session.flowing:
            return "keep"
        for complaint in found:
            self._print(f"  {complaint}", style="yellow")
        if not found:
            question, choices = "Enter to keep it, r to do it again", {"": "keep", "r": "redo"}
        elif take.is_single and capture.touch is None:
            question, choices = "Enter to do it again", {"": "redo"}
        else:
            question, choices = "Enter to do it again, k to keep it all the same", {"": "redo", "k": "keep"}
        choices["s"] = "skip"
        return choices[self._ask(f"  {question}, s to skip, q to stop: ", choices)]

    def _provenance(self, capture: Capture) -> dict[str, str]:
        return {
            "source": f"touchd record, touchd {metadata.version('touchd')}",
            "recorded": timestamp(time.time()),
            "sensor": description_of(self._pad.settings.sensor),
            "rate": str(pace_of(capture.frames)),
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
