"""The terminal view: pad, answer, time line, probabilities, and the robot's words."""

import signal
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, ConsoleOptions, RenderResult
from rich.live import Live
from rich.style import Style
from rich.text import Text

from touchd.daemon.app.config import Settings
from touchd.daemon.path.events import (
    Event,
    Label,
    LivePrediction,
    Prediction,
    RobotEvent,
    SensorEvent,
    TouchBegan,
)
from touchd.daemon.robot.words import name_of, words_of
from touchd.daemon.sinks.labels import Labeller, keys_of
from touchd.daemon.sinks.touches import Latest, ReportedTouch
from touchd.daemon.view.describe import confidence_of, describe
from touchd.daemon.view.elements import (
    ACCENT,
    BAD,
    CHANGED,
    FAINT,
    INK,
    MUTED,
    PAPER,
    ROBOT,
    Flag,
    bars,
    big,
    pad_picture,
    time_line,
)
from touchd.drivers.frame import COLUMNS, DEFAULT_PAD, FRAME_RATE_HZ, ROWS, Frame, ms_between

REFRESH_HZ = 12
# Time constant of the rest in frames, and four times the noise in counts, as on the live page.
REST_FRAMES = 54
NOISE_COUNTS = 3.0
# A touch is detected a little after it began: its first frames are among this many.
RECENT_FRAMES = 54
LONGEST_TRACE = 60 * 54
# A smaller terminal shows a part of the picture.
LEAST_COLUMNS, LEAST_ROWS = 60, 18
# Minimum height for a pad above a card.
LEAST_CARD_ROWS = 17
# Room for bars before the first answer.
FEWEST_BARS = 7
LARGEST_SCALE = 8
GAP = 2
BOLD = Style(bold=True)
# A message may hold a command to copy, which a single row would cut off.
NOTE_ROWS = 3


class View:
    """A sink that draws events, frames and notes. Thread-safe.

    Shows the first pad. console: standard output by default. card: lines to show if there is room.
    labeller: takes labels of the shown touch, given by keys; None if there are no labels.
    """

    def __init__(
        self, title: str, settings: Settings, console: Console | None = None, card: str = ""
    ) -> None:
        self._title = title
        self._words = words_of(settings)
        (self._shown_pad, shown), *_ = settings.pads.items()
        self._marks_s = [frames / FRAME_RATE_HZ for frames in shown.scene.answer_at_frames]
        self._card = card.splitlines()
        self._console = console or Console()
        self._lock = threading.Lock()
        self._rest: NDArray[np.float64] | None = None
        self._pressure = np.zeros((ROWS, COLUMNS))
        # The sensor's clock in ms and the sum of counts; seconds since the touch began and the sum of counts.
        self._recent: deque[tuple[int, float]] = deque(maxlen=RECENT_FRAMES)
        self._trace: deque[tuple[float, float]] = deque(maxlen=LONGEST_TRACE)
        self._latest = Latest()
        self._gestures: tuple[str, ...] = ()
        self._now: LivePrediction | None = None
        self._doing = ""
        self._note, self._is_note_bad = "", False
        self.labeller: Labeller | None = None
        self.is_watched = True
        self._live = Live(
            console=self._console,
            get_renderable=lambda: self,
            refresh_per_second=REFRESH_HZ,
            screen=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def start(self) -> None:
        """Do nothing; the context manager starts it."""

    def put_frame(self, frame: Frame, dropped: int = 0, pad: str = DEFAULT_PAD) -> None:
        """Show a frame at the next refresh, if it is the shown pad's. dropped: so far; the log reports it."""
        if pad != self._shown_pad:
            return
        with self._lock:
            touch = self._touch
            is_touched = touch is not None and touch.ended is None
            if self._rest is None:
                self._rest = frame.pressure.astype(np.float64)
            elif not is_touched:
                self._rest += (frame.pressure - self._rest) / REST_FRAMES
            self._pressure = np.maximum(frame.pressure - self._rest - NOISE_COUNTS, 0.0)
            load = float(self._pressure.sum())
            self._recent.append((frame.sensor_ms, load))
            if touch is not None and is_touched:
                self._trace.append((ms_between(touch.began.sensor_ms, frame.sensor_ms) / 1000, load))

    def note(self, text: str, is_bad: bool = False) -> None:
        with self._lock:
            self._note, self._is_note_bad = text, is_bad

    def doing(self, text: str) -> None:
        self._doing = text

    def on_key(self, key: str) -> None:
        """Label the touch on the screen with the gesture of a key; any other key does nothing."""
        if self.labeller is None:
            return
        gesture = keys_of(self.labeller.gestures[self._shown_pad]).get(key)
        touch = self._touch
        if gesture and touch:
            self.labeller.label(touch.began, gesture)

    def put(self, event: Event | LivePrediction) -> None:
        if not isinstance(event, RobotEvent) and event.pad != self._shown_pad:
            return
        with self._lock:
            self._now = event if isinstance(event, LivePrediction) else None
            if isinstance(event, LivePrediction | Prediction):
                self._gestures = tuple(event.probabilities)
            if not isinstance(event, LivePrediction):
                self._latest.put(event)
            if isinstance(event, TouchBegan):
                self._trace.clear()
                since = ((ms_between(event.sensor_ms, ms) / 1000, load) for ms, load in self._recent)
                self._trace.extend((at_s, load) for at_s, load in since if at_s >= 0.0)
        if isinstance(event, SensorEvent | RobotEvent | Label):
            self.note(describe(event, self._words), getattr(event, "state", "up") != "up")

    def stop(self, timeout_s: float = 0.0) -> None:
        """Restore the terminal, if it is still there."""
        with suppress(OSError):
            self._live.stop()

    def __enter__(self) -> "View":
        # Ctrl-Z would stop the daemon and leave the shell on this screen without a cursor.
        self._on_ctrl_z = signal.signal(signal.SIGTSTP, signal.SIG_IGN)
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        signal.signal(signal.SIGTSTP, self._on_ctrl_z)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the picture at the size of the terminal, line by line: rich joins and wraps text slowly."""
        width, height = console.size
        with self._lock:
            lines = self._draw(max(width, LEAST_COLUMNS), max(height, LEAST_ROWS))
        for number, line in enumerate(_fitted(lines, width, height)):
            line.stylize_before(PAPER)
            yield from line.render(console, "\n" if number < height - 1 else "")

    def _draw(self, width: int, height: int) -> list[Text]:
        keys = self._keys_lines(width)
        notes = self._note_lines(width - 2, max(1, min(height // 8, NOTE_ROWS)))
        body = height - 2 - len(keys) - len(notes)
        card = self._card if body - len(self._card) >= LEAST_CARD_ROWS else []
        scale = max(2, min((width * 9 // 20) // COLUMNS, (body - len(card) - 1) // 4, LARGEST_SCALE))
        left_width = COLUMNS * scale + GAP
        left = _fitted(self._left(scale, body, card), left_width, body)
        right = _fitted(self._right(width - 2 - left_width, body), width - 2 - left_width, body)
        lines = [Text.assemble(" ", *both) for both in zip(left, right, strict=True)]
        return [self._header(width), *lines, *keys, self._robot_line(), *notes]

    @property
    def _touch(self) -> ReportedTouch | None:
        """The ongoing touch, or else the last one."""
        return self._latest.touches[-1] if self._latest.touches else None

    def _header(self, width: int) -> Text:
        sensor, robot = self._latest.sensor, self._latest.robot
        vitals = Text()
        for name, state in (("pad", sensor.state if sensor else "awaited"), ("robot", robot and robot.state)):
            if state:
                style = {"up": ACCENT, "awaited": MUTED}.get(state, BAD)
                vitals.append(f"  {'●' if state == 'up' else '○'} ", style).append(f"{name} {state}", MUTED)
        title = Text.assemble((" touchd", INK + BOLD), (f"  {self._title}", MUTED))
        title.truncate(max(width - vitals.cell_len - 1, 0), overflow="crop", pad=True)
        return title.append_text(vitals)

    def _left(self, scale: int, height: int, card: Sequence[str]) -> list[Text]:
        lines = pad_picture(self._pressure, scale, self._console)
        if card:
            lines += [Text(), *(Text(line, "#ffffff on #000000") for line in card)]
        if height - len(lines) >= 2:
            lines.append(Text("Last touches", MUTED))
            lines += [self._last_touch(touch) for touch in reversed(self._latest.touches) if touch.ended]
        return lines

    def _last_touch(self, touch: ReportedTouch) -> Text:
        changes = list(dict.fromkeys(said.gesture for said in touch.predictions if said.told))
        name = self._name(touch.ended.gesture) if touch.ended else ""
        line = Text.assemble((f"{name} ", INK + BOLD), (f"{self._length_s(touch):.1f} s", MUTED))
        if len(changes) > 1:
            names = ", ".join(self._name(gesture) for gesture in changes[:-1])
            line.append(f" ↻ {names} before", CHANGED)
        if label := self._latest.labels.get(touch.began.touch):
            line.append(f" = {self._name(label)}", INK)
        return line

    def _length_s(self, touch: ReportedTouch) -> float:
        if touch.ended is not None:
            return touch.ended.frames / FRAME_RATE_HZ
        return self._trace[-1][0] if self._trace else 0.0

    def _right(self, width: int, height: int) -> list[Text]:
        touch = self._touch
        answers = touch.predictions if touch else []
        lines = [*self._answer(touch, width), *self._remarks(answers)]
        room_for_bars = min(max(len(self._gestures), FEWEST_BARS), max(height - 12, 3))
        line_height = height - len(lines) - room_for_bars
        if line_height >= 3:
            flags = [self._flag(answers, at) for at in range(len(answers))]
            lines += time_line(self._trace, self._marks_s, flags, (width, line_height))
        # The bars are empty between touches.
        answer = answers[-1] if touch and touch.ended is None and answers else None
        shown = self._now or answer
        shares, stands = shown.probabilities if shown else {}, answer.gesture if answer else ""
        names = {gesture: self._name(gesture) for gesture in self._gestures}
        return lines + bars(names, shares, stands, (width, room_for_bars))

    def _answer(self, touch: ReportedTouch | None, width: int) -> list[Text]:
        """Return which touch is shown, and its answer in large letters."""
        which, word, style = "No touch yet", "...", FAINT
        if touch is not None:
            which = "Touch" if touch.ended is None else "Last touch:"
            which = f"{which} {touch.began.touch} · {self._length_s(touch):.1f} s"
        if touch and touch.predictions:
            word = self._name(touch.predictions[-1].gesture)
            style = MUTED if touch.ended else CHANGED if self._before(touch.predictions) else ACCENT
        elif touch is None or touch.ended is not None:
            sensor = self._latest.sensor
            word = "no pad" if sensor and sensor.state == "down" else "touch me"
        return [Text(which, MUTED), *(Text(row, style + BOLD) for row in big(word, width))]

    def _remarks(self, answers: Sequence[Prediction]) -> list[Text]:
        if not answers:
            return [Text(), Text()]
        answer = answers[-1]
        confidence = confidence_of(answer)
        after = f"{' sure, ' if confidence else ''}after {answer.elapsed_s:.3g} s"
        sure = Text.assemble((confidence, INK + BOLD), (after, INK))
        remark = Text()
        if before := self._before(answers):
            remark.append(f"↻ was {before} · ", CHANGED)
        told = [said for said in answers if said.told and said.gesture == answer.gesture]
        status = f"told after {told[0].elapsed_s:.3g} s" if told else "not sure enough to tell"
        remark.append(status, MUTED)
        likeliest = max(answer.probabilities, key=lambda label: answer.probabilities[label])
        if likeliest != answer.gesture and answer.gesture in answer.probabilities:
            remark.append(f" · {self._name(likeliest)} is likelier now", MUTED)
        return [sure, remark]

    def _flag(self, answers: Sequence[Prediction], at: int) -> Flag:
        said, before = answers[at], self._before(answers[: at + 1])
        parts = "↻" if before else "", self._name(said.gesture), confidence_of(said), "✓" if said.told else ""
        return Flag(said.elapsed_s + said.age_ms / 1000.0, " ".join(filter(None, parts)), bool(before))

    def _before(self, answers: Sequence[Prediction]) -> str:
        """Return the name of the told answer that the last one replaced, or ""."""
        *earlier, last = answers
        replaced = [one.gesture for one in earlier if one.told and one.gesture != last.gesture]
        return self._name(replaced[-1]) if last.changed and replaced else ""

    def _robot_line(self) -> Text:
        action = self._latest.action
        if action is None:
            return Text()
        what = " ".join(action.what.split())
        words = what if action.action == "behavior" else f"“{what}”"
        return Text.assemble((" Robot ", MUTED), (words, ROBOT + BOLD))

    def _keys_lines(self, width: int) -> list[Text]:
        """Return the key of each label for the shown touch; blank lines without a touch."""
        if self.labeller is None:
            return []
        lines, touch = [Text(" It was: ", MUTED)], self._touch
        label = self._latest.labels.get(touch.began.touch) if touch else None
        for key, gesture in keys_of(self.labeller.gestures[self._shown_pad]).items():
            style = ACCENT if gesture == label else INK
            entry = Text.assemble((key, style + BOLD), (f" {self._name(gesture)}  ", style))
            # The two blanks at the end of a line may be cropped.
            if lines[-1].cell_len + entry.cell_len > width + 2:
                lines.append(Text(" "))
            lines[-1].append_text(entry)
        return lines if touch else [Text() for _ in lines]

    def _note_lines(self, width: int, most: int) -> list[Text]:
        """Return what is going on and the latest note, wrapped to `width` and cut after `most` rows."""
        note = Text(f" {self._doing} " if self._doing else "", INK)
        note.append(f" {self._note}", BAD if self._is_note_bad else FAINT)
        note.truncate(width * most, overflow="ellipsis")
        return [*note.wrap(self._console, width)][:most]

    def _name(self, gesture: str) -> str:
        return " ".join(name_of(self._words, gesture).split())


def _fitted(lines: Sequence[Text], width: int, height: int) -> list[Text]:
    """Return lines cropped or padded to a width and a height."""
    fitted = [*lines, *(Text() for _ in range(height))][:height]
    for line in fitted:
        line.truncate(width, overflow="crop", pad=True)
    return fitted
