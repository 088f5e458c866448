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

    Left out are the rest beside a touch, which is too short to learn from, and a short touch without rest
    after it.
    """
    found: list[Recording] = []
    for place, part in enumerate(parts):
        before = [other for other in parts[max(0, place - 1) : place] if _follows(other, part)]
        after = [other for other in parts[place + 1 : place + 2] if _follows(part, other)]
        is_short = _frames(part.sensor_ms[-1] - part.sensor_ms[0]) < WINDOW_FRAMES
        if not (before or after) or (part.gesture != NO_TOUCH and not is_short):
            found.append(on_grid(part))
        elif part.gesture != NO_TOUCH:
            found += _in_passing(part, [*before, part, *after])
    return found


def whole(parts: Sequence[Recording]) -> Recording:
    """Return parts that follow one another as one recording, with the labels of the first."""
    counts, sensor_ms = ([getattr(part, name) for part in parts] for name in ("counts", "sensor_ms"))
    return replace(parts[0], counts=np.concatenate(counts), sensor_ms=np.concatenate(sensor_ms))


def _frames(ms: np.int64) -> int:
    return round(float(ms) * FRAME_RATE_HZ / 1000.0)


def _follows(one: Recording, other: Recording) -> bool:
    """Whether one is a touch and the other the rest just after it, or the other way round."""
    is_pair = (one.gesture == NO_TOUCH) != (other.gesture == NO_TOUCH) and set_up(one) == set_up(other)
    return is_pair and bool(0 < other.sensor_ms[0] - one.sensor_ms[-1] <= CUT_MS)


def _in_passing(touch: Recording, parts: Sequence[Recording]) -> list[Recording]:
    """Return a touch and the rest around it as one recording; none if it cannot be learnt from."""
    start_ms, end_ms = parts[0].sensor_ms[0], parts[-1].sensor_ms[-1]
    laid = on_grid(whole(parts))
    first = _frames(touch.sensor_ms[0] - start_ms)
    over = _frames(touch.sensor_ms[-1] - start_ms) + 1
    has_gap = len(laid.counts) < _frames(end_ms - start_ms) - 1
    if has_gap or over - first < LEAST_FRAMES or len(laid.counts) - over < LEAST_AFTER_FRAMES:
        return []
    return [InPassing(*set_up(laid), touch.gesture, laid.counts, laid.sensor_ms, "live", first, over)]
