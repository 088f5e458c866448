"""Events put together again to touches: each with what was said of it, from a pipeline or from a journal."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from daemon.events import Event, EventError, Prediction, TouchBegan, TouchEnded, decode
from daemon.journal import JournalError

# The end of a journal that is looked at, thousands of touches; one may grow to gigabytes.
TAIL_BYTES = 4_000_000


@dataclass
class Touch:
    """One touch. ended: None when it goes on, or when its end is not known."""

    began: TouchBegan
    predictions: list[Prediction] = field(default_factory=list)
    ended: TouchEnded | None = None


def gather(events: Iterable[Event]) -> list[Touch]:
    """Return the touches that events tell of, in order; what belongs to none of them is left out."""
    touches: list[Touch] = []
    for event in events:
        match event:
            case TouchBegan():
                touches.append(Touch(event))
            case Prediction() if touches and touches[-1].began.touch == event.touch:
                touches[-1].predictions.append(event)
            case TouchEnded() if touches and touches[-1].began.touch == event.touch:
                touches[-1].ended = event
    return touches


def read_journal(path: Path) -> list[Touch]:
    """Return the touches in the last part of a journal; raises JournalError when it is none."""
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            file.seek(max(0, size - TAIL_BYTES))
            lines = file.read(TAIL_BYTES).split(b"\n")
    except OSError as error:
        raise JournalError(f"journal {path}: cannot be read ({error.strerror}); check the path") from error
    # What stands before the first newline of a part, and after the last of any, is no whole line.
    whole = lines[1 if size > TAIL_BYTES else 0 : -1]
    try:
        return gather([decode(line) for line in whole])
    except EventError as error:
        raise JournalError(
            f"{path}: neither a journal of events nor a .csv or .csv.gz of recordings ({error})"
        ) from error
