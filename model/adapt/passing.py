"""Touches in passing: a hand comes, touches once or a few times, and goes; then the pad rests.

Such a touch is over before the windows in which longer ones are answered. What it was shows in the touch and
the rest after it, so both are learnt from.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from touchd.drivers.frame import FRAME_RATE_HZ, NO_TOUCH
from touchd.drivers.recording import Recording, on_grid, set_up

# The longest window: a longer touch is a recording like any other.
WINDOW_FRAMES = 144
# Contacts shorter than this, or with less rest after them, are passed over.
LEAST_FRAMES, LEAST_AFTER_FRAMES = 2, 9
# Pieces of one file further apart do not belong together.
CUT_MS = 1000
# The key of ended touches in passing, beside the lengths of windows.
IN_PASSING = 0


@dataclass(frozen=True, eq=False)
class InPassing(Recording):
    """A short touch with the rest around it.

    counts: rest, the touch, rest. first, over: the touch's first frame, and the one after its last contact.
    """

    first: int
    over: int


def joined(parts: Sequence[Recording]) -> list[Recording]:
    """Return a file's recordings on the grid, each short touch together with the rest beside it.

    Left out are the rest beside a longer touch, which is too short to learn from, and a short touch without
    rest after it.
    """
    found: list[Recording] = []
    taken: set[int] = set()
    for place, part in enumerate(parts):
        beside = [other for other in (place - 1, place + 1) if _is_rest_beside(parts, place, other)]
        if not beside:
            continue
        taken |= {*beside}
        if _frames(part.sensor_ms[-1] - part.sensor_ms[0]) < WINDOW_FRAMES:
            taken.add(place)
            found += _in_passing(part, [parts[other] for other in sorted((place, *beside))])
    return [*found, *(on_grid(part) for place, part in enumerate(parts) if place not in taken)]


def _frames(ms: np.int64) -> int:
    return round(float(ms) * FRAME_RATE_HZ / 1000.0)


def _is_rest_beside(parts: Sequence[Recording], place: int, other: int) -> bool:
    """Whether another part of the file is the rest just before a touch, or just after it."""
    if not 0 <= other < len(parts):
        return False
    touch, rest = parts[place], parts[other]
    earlier, later = (rest, touch) if other < place else (touch, rest)
    pause_ms = later.sensor_ms[0] - earlier.sensor_ms[-1]
    is_touch = touch.gesture != NO_TOUCH and touch.framing == "live"
    return bool(
        is_touch and rest.gesture == NO_TOUCH and set_up(rest) == set_up(touch) and 0 < pause_ms <= CUT_MS
    )


def _in_passing(touch: Recording, parts: Sequence[Recording]) -> list[Recording]:
    """Return a touch and the rest around it as one recording; none if it cannot be learnt from."""
    counts = np.concatenate([part.counts for part in parts])
    sensor_ms = np.concatenate([part.sensor_ms for part in parts])
    laid = on_grid(replace(touch, counts=counts, sensor_ms=sensor_ms))
    first = _frames(touch.sensor_ms[0] - sensor_ms[0])
    over = _frames(touch.sensor_ms[-1] - sensor_ms[0]) + 1
    has_gap = len(laid.counts) < _frames(sensor_ms[-1] - sensor_ms[0]) - 1
    if has_gap or over - first < LEAST_FRAMES or len(laid.counts) - over < LEAST_AFTER_FRAMES:
        return []
    return [InPassing(*set_up(laid), laid.gesture, laid.counts, laid.sensor_ms, "live", first, over)]
