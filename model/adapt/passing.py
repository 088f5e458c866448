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
        if part.gesture == NO_TOUCH:
            continue
        before, after = _rest_beside(parts, place, -1), _rest_beside(parts, place, +1)
        if before is None and after is None:
            continue
        taken |= {other for other, rest in ((place - 1, before), (place + 1, after)) if rest is not None}
        if _frames(part) < WINDOW_FRAMES:
            taken.add(place)
            found += _in_passing(before, part, after)
    return [*found, *(on_grid(part) for place, part in enumerate(parts) if place not in taken)]


def _frames(part: Recording) -> float:
    return float(part.sensor_ms[-1] - part.sensor_ms[0]) * FRAME_RATE_HZ / 1000.0


def _rest_beside(parts: Sequence[Recording], place: int, step: int) -> Recording | None:
    """Return the rest that follows a touch without a pause, or precedes it, in the same file."""
    other = place + step
    if not 0 <= other < len(parts):
        return None
    touch, rest = parts[place], parts[other]
    earlier, later = (rest, touch) if step < 0 else (touch, rest)
    pause_ms = later.sensor_ms[0] - earlier.sensor_ms[-1]
    is_beside = rest.gesture == NO_TOUCH and set_up(rest) == set_up(touch) and 0 < pause_ms <= CUT_MS
    return rest if is_beside and touch.framing == "live" else None


def _in_passing(before: Recording | None, touch: Recording, after: Recording | None) -> list[Recording]:
    """Return a touch and the rest around it as one recording; none if it cannot be learnt from."""
    parts = [part for part in (before, touch, after) if part is not None]
    counts = np.concatenate([part.counts for part in parts])
    sensor_ms = np.concatenate([part.sensor_ms for part in parts])
    laid = on_grid(replace(touch, counts=counts, sensor_ms=sensor_ms))

    def place(ms: int) -> int:
        return round(float(ms - sensor_ms[0]) * FRAME_RATE_HZ / 1000.0)

    first, over = place(touch.sensor_ms[0]), place(touch.sensor_ms[-1]) + 1
    has_gap = len(laid.counts) < place(sensor_ms[-1]) - 1
    if has_gap or over - first < LEAST_FRAMES or len(laid.counts) - over < LEAST_AFTER_FRAMES:
        return []
    own = {name: getattr(laid, name) for name in Recording.__dataclass_fields__}
    return [InPassing(**own, first=first, over=over)]
