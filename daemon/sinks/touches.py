"""Reads events back from lines and journals, and groups them by touch."""

from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import TypeAlias

import msgspec

from touchd.daemon.path.events import (
    Event,
    Label,
    Prediction,
    RobotAction,
    RobotEvent,
    SensorEvent,
    TouchBegan,
    TouchEnded,
    epoch_s,
)
from touchd.daemon.sinks.journal import FIRST_BYTES, MAX_LINE_BYTES, JournalError, journal_files
from touchd.drivers.errors import os_errors_as
from touchd.drivers.whole_file import open_nonblocking

# The beginning of a label's line.
LABEL = FIRST_BYTES + b'label"'
# How many touches of a pad, and answers to a touch, the page and the terminal view keep.
TOUCHES, PREDICTIONS = 40, 24
# The year 2500: earlier times fit into the nanoseconds of every format that touchd writes.
LAST_S = 16_725_225_600.0

# The time and number of a touch's `touch_began`; numbers begin with 1 again after a restart.
TouchKey: TypeAlias = tuple[str, int]


class EventError(ValueError):
    """A line is not an event; the message says what is wrong with it."""


class ReportedTouch(msgspec.Struct):
    """One touch and its events. ended: None while it goes on, or if its end is not known."""

    began: TouchBegan
    predictions: list[Prediction] = []
    ended: TouchEnded | None = None

    def add(self, event: Prediction | TouchEnded) -> None:
        """Add an answer or the end; those of another touch are ignored."""
        if event.touch == self.began.touch:
            if isinstance(event, Prediction):
                self.predictions.append(event)
            else:
                self.ended = event


def gather(events: Iterable[Event]) -> list[ReportedTouch]:
    """Group events by touch, in order; events that belong to no touch are ignored."""
    touches: list[ReportedTouch] = []
    latest: dict[str, ReportedTouch] = {}
    for event in events:
        match event:
            case TouchBegan():
                latest[event.pad] = ReportedTouch(event)
                touches.append(latest[event.pad])
            case Prediction() | TouchEnded() if event.pad in latest:
                latest[event.pad].add(event)
    return touches


class Latest:
    """A pad's last touches, the last states, and the robot's reaction to the last touch; bounded.

    labels: what touches were, as people say, by their numbers.
    """

    def __init__(self) -> None:
        self.touches: deque[ReportedTouch] = deque(maxlen=TOUCHES)
        self.labels: dict[int, str] = {}
        self.sensor: SensorEvent | None = None
        self.robot: RobotEvent | None = None
        self.action: RobotAction | None = None

    def put(self, event: Event) -> None:
        """Take an event, unless its touch began before we listened."""
        match event:
            case SensorEvent():
                self.sensor = event
            case RobotEvent():
                self.robot = event
            case RobotAction() if event.action != "leds":
                self.action = event
            case TouchBegan():
                self.action = None
                self.touches.append(ReportedTouch(event))
                self.labels = {touch: label for touch, label in self.labels.items() if self.find(touch)}
            case Label() if self.find(event.touch):
                self.labels[event.touch] = event.gesture
            case Prediction() | TouchEnded() if self.touches:
                self.touches[-1].add(event)
                del self.touches[-1].predictions[:-PREDICTIONS]

    def find(self, touch: int) -> TouchBegan | None:
        """Return the `touch_began` of one of the last touches, None if it is not among them."""
        return next((one.began for one in self.touches if one.began.touch == touch), None)


def decode(line: bytes | str) -> Event:
    """Return the event that a line of JSON holds; raises EventError when it holds none."""
    try:
        event: Event = msgspec.json.decode(line, type=Event)
        if not 0.0 <= epoch_s(event.time) < LAST_S:
            raise ValueError(f"time {event.time}")
    # RecursionError: lists nested too deeply.
    except (msgspec.DecodeError, ValueError, OverflowError, RecursionError) as error:
        raise EventError(f"not an event: {error}") from error
    return event


def read_events(path: Path, begin: bytes = b"") -> tuple[list[Event], list[EventError]]:
    """Parse a journal into events and errors; a last line without its end is left for later.

    begin: of the lines to read. Raises JournalError; FileNotFoundError is its cause when there is no file.
    """
    events: list[Event] = []
    wrong: list[EventError] = []
    reading = os_errors_as(JournalError, f"journal {path}: cannot be read", "check the path")
    with reading, open(path, "rb", opener=open_nonblocking) as file:
        while line := file.readline(MAX_LINE_BYTES):
            if not line.startswith(begin):
                continue
            if line.endswith(b"\n"):
                try:
                    events.append(decode(line))
                except EventError as error:
                    wrong.append(error)
            elif len(line) == MAX_LINE_BYTES:
                wrong.append(EventError("longer than any event; not a journal"))
    return events, wrong


def read_labels(path: Path, pad: str) -> dict[TouchKey, str]:
    """Return the last label of each labelled touch on a pad.

    Also reads older files (path.1 and so on); skips partial lines and lines without an event. Raises
    JournalError if an existing file cannot be read.
    """
    labels: dict[TouchKey, str] = {}
    # Resolve a symlink: the older files are beside its target. Newest first: a file that is rotated at the
    # same time is read twice rather than missed.
    for file in journal_files(path.resolve()):
        try:
            events, _ = read_events(file, begin=LABEL)
        except JournalError as error:
            # Just rotated away, or not there yet.
            if isinstance(error.__cause__, FileNotFoundError):
                continue
            raise
        found = (event for event in events if isinstance(event, Label) and event.pad == pad)
        labels = {(label.began, label.touch): label.gesture for label in found} | labels
    return labels
