"""Made touches as the daemon's touch sink gathers them, and what its files hold, for tests."""

from dataclasses import dataclass

import numpy as np

from touchd.daemon.path.events import TouchBegan, TouchEnded, timestamp
from touchd.daemon.sinks.touch_store import EndedTouch, SavedTouch
from touchd.drivers.frame import Frame
from touchd.drivers.recording import UNLABELLED, Recording, read_recordings

FRAMES = 20
FIRST_S = 1795168800.0


def ended_touch(number: int, rest_frames: int = 10, after_s: float = 0.0) -> EndedTouch:
    """Return touch `number`: 20 frames between `rest_frames` of rest, a second after the previous one."""
    counts = np.full((8, 8), number % 1024, np.uint16)
    frames = tuple(Frame(19 * i, 0.0, counts) for i in range(FRAMES + 2 * rest_frames))
    first_ms, last_ms = 19 * rest_frames, 19 * (rest_frames + FRAMES - 1)
    when = timestamp(FIRST_S + number + after_s)
    return EndedTouch(
        TouchBegan(touch=number, time=when, sensor_ms=first_ms),
        TouchEnded(
            touch=number, gesture="rub", frames=FRAMES, reason="released", time=when, sensor_ms=last_ms
        ),
        frames,
    )


@dataclass(frozen=True, eq=False)
class SavedFrames:
    """What a saved touch's file holds; rest before and quiet after it may be missing."""

    before: Recording | None
    touch: Recording
    after: Recording | None


def read_frames(saved: SavedTouch) -> SavedFrames:
    parts = read_recordings(saved.path)
    (place,) = (number for number, part in enumerate(parts) if part.gesture == UNLABELLED)
    before, after = parts[:place], parts[place + 1 :]
    return SavedFrames(before[0] if before else None, parts[place], after[0] if after else None)
