"""Touches in passing: a hand touches the pad once or a few times and leaves; then the pad rests.

Such a touch ends before the windows at which longer touches are answered. Both the touch and the rest after
it show what it was, so a model learns from both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from touchd.drivers.frame import FRAME_RATE_HZ, NO_TOUCH
from touchd.drivers.recording import Recording, on_grid, setup_of

# The longest window; a longer touch is an ordinary recording.
WINDOW_FRAMES = 144
# Shorter contacts, or contacts with less rest after them, are not used.
LEAST_FRAMES, LEAST_AFTER_FRAMES = 2, 9
# Parts of a file with a longer gap between them do not belong together.
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

    Drops rest beside a touch, which alone is too short to learn from, and short touches without rest after.
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


def concatenated(parts: Sequence[Recording]) -> Recording:
    """Return parts that follow one another as one recording, with the labels of the first."""
    counts, sensor_ms = ([getattr(part, name) for part in parts] for name in ("counts", "sensor_ms"))
    return replace(parts[0], counts=np.concatenate(counts), sensor_ms=np.concatenate(sensor_ms))


def _frames(ms: np.int64) -> int:
    return round(float(ms) * FRAME_RATE_HZ / 1000.0)


def _follows(one: Recording, other: Recording) -> bool:
    """Whether `other` follows `one`, and one of them is a touch and the other rest."""
    is_pair = (one.gesture == NO_TOUCH) != (other.gesture == NO_TOUCH) and setup_of(one) == setup_of(other)
    return is_pair and bool(0 < other.sensor_ms[0] - one.sensor_ms[-1] <= CUT_MS)


def _in_passing(touch: Recording, parts: Sequence[Recording]) -> list[Recording]:
    """Return a touch and the rest around it as one recording; none if it is too short or has a gap."""
    start_ms, end_ms = parts[0].sensor_ms[0], parts[-1].sensor_ms[-1]
    laid = on_grid(concatenated(parts))
    first = _frames(touch.sensor_ms[0] - start_ms)
    over = _frames(touch.sensor_ms[-1] - start_ms) + 1
    has_gap = len(laid.counts) < _frames(end_ms - start_ms) - 1
    if has_gap or over - first < LEAST_FRAMES or len(laid.counts) - over < LEAST_AFTER_FRAMES:
        return []
    return [InPassing(*setup_of(laid), touch.gesture, laid.counts, laid.sensor_ms, "live", first, over)]
