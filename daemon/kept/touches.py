"""Groups events by touch, from a pipeline or from a journal."""

import os
from collections.abc import Iterable
from contextlib import suppress
from itertools import chain
from pathlib import Path

import msgspec

from daemon.events import Event, EventError, Prediction, TouchBegan, TouchEnded, decode
from daemon.kept.journal import MAX_LINE_BYTES, JournalError

# Only the end of a journal is read, thousands of touches; a journal may have gigabytes.
TAIL_BYTES = 4_000_000


class ReportedTouch(msgspec.Struct):
    """One touch. ended: None when it goes on, or when its end is not known."""

    began: TouchBegan
    predictions: list[Prediction] = []
    ended: TouchEnded | None = None

    def add(self, event: Prediction | TouchEnded) -> None:
        if isinstance(event, Prediction):
            self.predictions.append(event)
        else:
            self.ended = event


def gather(events: Iterable[Event]) -> list[ReportedTouch]:
    """Return the touches among events, in order; events of no touch are left out."""
    touches: list[ReportedTouch] = []
    latest: dict[str, ReportedTouch] = {}
    for event in events:
        match event:
            case TouchBegan():
                latest[event.pad] = ReportedTouch(event)
                touches.append(latest[event.pad])
            case Prediction() | TouchEnded():
                touch = latest.get(event.pad)
                if touch is not None and touch.began.touch == event.touch:
                    touch.add(event)
    return touches


def read_journal(path: Path) -> list[ReportedTouch]:
    """Return the touches in the last part of a journal; raises JournalError when it is not a journal."""
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            file.seek(max(0, size - TAIL_BYTES))
            lines = file.read(TAIL_BYTES).split(b"\n")
    except OSError as error:
        raise JournalError(f"journal {path}: cannot be read ({error.strerror}); check the path") from error
    # Text before a part's first newline, or after the last newline, is not a whole line.
    whole = lines[1 if size > TAIL_BYTES else 0 : -1]
    events: list[Event] = []
    wrong = ""
    for line in whole:
        try:
            events.append(decode(line))
        except EventError as error:
            wrong = str(error)
    if wrong and not events:
        raise JournalError(
            f"{path}: neither a journal of events nor a .csv or .csv.gz of recordings ({wrong})"
        )
    return gather(events)


def read_since(path: Path, time: str) -> list[ReportedTouch]:
    """Return the touches of a journal that began at a time (as in events) or later, oldest first.

    Looks through older files (path.1 and so on) too, as far back as needed; passes over half lines and what
    is no event. Raises JournalError when a file is there and cannot be read.
    """
    parts: list[list[Event]] = []
    for file in _newest_first(path):
        try:
            events, reaches_back = _events_since(file, time)
        except FileNotFoundError:
            # Rotated away meanwhile, or not there yet.
            continue
        except OSError as error:
            raise JournalError(
                f"journal {file}: cannot be read ({error.strerror}); check the path"
            ) from error
        parts.insert(0, events)
        if reaches_back:
            break
    return [touch for touch in gather(chain.from_iterable(parts)) if touch.began.time >= time]


def _newest_first(path: Path) -> list[Path]:
    """Return a journal and its older files, whichever numbers are there."""
    with suppress(OSError):
        numbers = [name.removeprefix(f"{path.name}.") for name in os.listdir(path.parent)]
        found = sorted(int(number) for number in numbers if number.isascii() and number.isdecimal())
        return [path, *(path.with_name(f"{path.name}.{number}") for number in found)]
    return [path]


def _events_since(path: Path, time: str) -> tuple[list[Event], bool]:
    """Return a file's events of a time or later, and whether it has earlier ones too."""
    events: list[Event] = []
    reaches_back = False
    with path.open("rb") as file:
        while line := file.readline(MAX_LINE_BYTES):
            with suppress(EventError):
                event = decode(line)
                if event.time >= time:
                    events.append(event)
                else:
                    reaches_back = True
    return events, reaches_back
