"""The frames around a finished touch, cut into rest before, touch, and quiet after."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from touchd.daemon.events import TouchBegan, TouchEnded
from touchd.drivers.frame import CLOCK_MODULUS, Frame
from touchd.drivers.pad.pace import clock_ms, pace_of
from touchd.drivers.recording import NO_TOUCH, UNLABELLED, Recording

LEAD_MS = 1000
# Frames further apart than this are not contiguous.
CUT_MS = 1000


@dataclass(frozen=True, eq=False)
class FeltTouch:
    """A touch that is over, and the pad's frames around it, in the order in which they came.

    noticed: how many of the frames had come when the touch was noticed. end_ms: the sensor's clock at its
    last contact. quiet_from_ms: the same of the touch before, None where none is known.
    """

    began: TouchBegan
    ended: TouchEnded
    frames: tuple[Frame, ...]
    noticed: int
    end_ms: int
    quiet_from_ms: int | None


@dataclass(frozen=True, eq=False)
class TouchPieces:
    """The frames of a touch, and those before and after it in which nothing touched; either may be none."""

    before: tuple[Frame, ...]
    touch: tuple[Frame, ...]
    after: tuple[Frame, ...]
    is_whole: bool

    @property
    def rate(self) -> str:
        """How fast the frames came, in words."""
        frames = (*self.before, *self.touch, *self.after)
        return str(pace_of(frames)) if len(frames) > 1 else "unknown"

    def recordings(self) -> list[Recording]:
        """Return them as unlabelled recordings on one clock."""
        pieces = ((NO_TOUCH, self.before), (UNLABELLED, self.touch), (NO_TOUCH, self.after))
        who = (UNLABELLED, UNLABELLED, UNLABELLED)
        clocks = np.split(
            clock_ms([frame for _, piece in pieces for frame in piece]),
            np.cumsum([len(self.before), len(self.touch)]),
        )
        return [
            Recording(*who, gesture, np.stack([frame.pressure for frame in piece]), ms, "live")
            for (gesture, piece), ms in zip(pieces, clocks, strict=True)
            if piece
        ]


def cut(felt: FeltTouch) -> TouchPieces:
    """Return the touch from its true first frame to its last contact, with the rest before and after it.

    Before it LEAD_MS at most, and nothing of an earlier touch. What came after a touch that was not let go,
    but lost or taken for the pad's rest, is left out.
    """
    frames = felt.frames
    began_ms = felt.began.sensor_ms
    first = _walk_back(frames, felt.noticed - 1, began_ms)
    lead_ms = LEAD_MS
    if felt.quiet_from_ms is not None:
        lead_ms = min(LEAD_MS, (began_ms - felt.quiet_from_ms) % CLOCK_MODULUS - 1)
    start = _walk_back(frames, first, began_ms - lead_ms)
    stop = first + 1
    while stop < len(frames) and _is_next(frames, stop) and _is_from(felt.end_ms, frames[stop].sensor_ms):
        stop += 1
    return TouchPieces(
        before=frames[start:first],
        touch=frames[first:stop],
        after=frames[stop:] if felt.ended.reason == "released" else (),
        is_whole=stop < len(frames) or _is_from(frames[-1].sensor_ms, felt.end_ms),
    )


def _walk_back(frames: Sequence[Frame], place: int, until_ms: int) -> int:
    """Return the first frame of the stretch up to `place` that is not before a time on the pad's clock."""
    while place > 0 and _is_next(frames, place) and _is_from(frames[place - 1].sensor_ms, until_ms):
        place -= 1
    return place


def _is_next(frames: Sequence[Frame], place: int) -> bool:
    """Whether a frame goes on from the one before it."""
    return (frames[place].sensor_ms - frames[place - 1].sensor_ms) % CLOCK_MODULUS <= CUT_MS


def _is_from(ms: int, since_ms: int) -> bool:
    """Whether a time is not before another, on a clock that wraps."""
    return (ms - since_ms) % CLOCK_MODULUS < CLOCK_MODULUS // 2
