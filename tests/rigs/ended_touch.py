"""A made touch as the daemon's touch sink gathers it, for the tests of kept touches."""

import numpy as np

from touchd.daemon.path.events import TouchBegan, TouchEnded, timestamp
from touchd.daemon.sinks.touch_store import EndedTouch
from touchd.drivers.frame import Frame

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
        rest_frames + 3,
        last_ms,
        None,
    )
