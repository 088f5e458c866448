"""A simulated pad, and the simulated hand of `touchd demo` and `touchd fake-pad`.

The hand makes one gesture after another. It is a pointer like those of a page's viewers, and stays away while
a viewer's pointer is at the pad.
"""

import itertools
import math
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import Protocol, TypeAlias, cast

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from touchd.drivers.fakes.pointers import Pointer, PressingHands, Size
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, ROWS, Counts, Frame

# Measured on HAART at rest and under load: noise per taxel and frame, spread of the taxels' sensitivity (as a
# logarithm), and the share of a row's pressure that leaks to each of its taxels.
NOISE_COUNTS, UNEVENNESS, ROW_LEAK = 0.75, 0.35, 0.02
# Longest touch of the hand, and the shortest pause, which ends a touch.
LONGEST_TOUCH_S, SHORTEST_PAUSE_S = 3.8, 1.5
# The hand resumes when no pointer has been at the pad for this long.
ALONE_S = 20.0
# Deviation of a heading from up and down the pad, in radians; 313 of 380 recorded strokes go that way.
ASLANT = 0.35

# Where the hand is, in taxels, at a time in seconds; None: off the pad.
Path: TypeAlias = Callable[[float], tuple[float, float] | None]
Range: TypeAlias = tuple[float, float]
Draw: TypeAlias = Callable[[RandomState], Path]


class Fabric:
    """One pad, with a rest level and a sensitivity for each taxel."""

    def __init__(self, rng: RandomState) -> None:
        self._rng = rng
        self._rest = rng.gamma(2.0, 1.0, (ROWS, 1)) + rng.uniform(-0.5, 0.5, (ROWS, COLUMNS))
        self._sensitivity = rng.lognormal(0.0, UNEVENNESS, (ROWS, COLUMNS))

    def read(self, pressed: NDArray[np.float64]) -> Counts:
        """Return the pad's counts under a pressure (..., 8, 8), uint16."""
        loaded = pressed * self._sensitivity
        leak = ROW_LEAK * loaded.sum(axis=-1, keepdims=True)
        noise = NOISE_COUNTS * self._rng.normal(size=pressed.shape)
        counts = np.rint(self._rest + loaded + leak + noise).clip(0, MAX_COUNT)
        return cast(Counts, counts.astype(np.uint16))


def middle(rng: RandomState) -> tuple[float, float]:
    """Return a place near the middle of the pad."""
    row, column = rng.normal(3.5, 0.5, 2)
    return float(row), float(column)


def up_or_down(rng: RandomState) -> float:
    """Return a heading, in radians."""
    return float(rng.choice([-0.5, 0.5]) * math.pi + rng.normal(0.0, ASLANT))


def constant(rng: RandomState) -> Path:
    """Lie still."""
    place = middle(rng)
    return lambda time_s: place


def pat(rng: RandomState) -> Path:
    """Pat in one place, about three times a second."""
    place, down_s, every_s = middle(rng), rng.uniform(0.08, 0.2), rng.uniform(0.28, 0.4)
    return lambda time_s: place if time_s % every_s < down_s else None


def stroke(
    down_s: Range, every_s: Range, length: Range, heading: Callable[[RandomState], float] = up_or_down
) -> Draw:
    """Return strokes in one direction. Durations, periods and lengths (in taxels) are from these ranges."""

    def make(rng: RandomState) -> Path:
        (row, column), angle = middle(rng), heading(rng)
        down, every, taxels = (rng.uniform(*each) for each in (down_s, every_s, length))

        def path(time_s: float) -> tuple[float, float] | None:
            part = time_s % every / down
            if part >= 1.0:
                return None
            # Slower at the ends, faster in the middle, moving throughout.
            along = taxels * (part - 0.5 - 0.25 * math.sin(2.0 * math.pi * part) / math.pi)
            return row + along * math.sin(angle), column + along * math.cos(angle)

        return path

    return make


def to_and_fro(pace_hz: Range, reach: Range, heading: Callable[[RandomState], float] = up_or_down) -> Draw:
    """Return back-and-forth paths; pace in Hz and reach in taxels are from these ranges."""

    def make(rng: RandomState) -> Path:
        (row, column), angle = middle(rng), heading(rng)
        pace, taxels = rng.uniform(*pace_hz), rng.uniform(*reach)

        def path(time_s: float) -> tuple[float, float]:
            along = taxels * math.cos(2.0 * math.pi * pace * time_s)
            return row + along * math.sin(angle), column + along * math.cos(angle)

        return path

    return make


# With the paces and directions of HAART's recordings. The simulated hand cannot tickle as people do.
PLAYED: Mapping[str, tuple[Size, Draw]] = {
    "constant": ("hand", constant),
    "pat": ("hand", pat),
    "rub": ("hand", to_and_fro((1.2, 2.2), (0.7, 1.9))),
    "scratch": ("fingertips", to_and_fro((2.5, 4.0), (0.4, 0.9))),
    # About once a second, over half of the pad or more.
    "stroke": ("hand", stroke((0.4, 0.7), (0.85, 1.2), (4.0, 6.5))),
}


class Pointers(Protocol):
    """The pointers of people. near_s: when one was last at the pad, pressing or about to."""

    near_s: float

    def pointers(self) -> dict[Hashable, Pointer]:
        """Return the pointers that press now, by identity."""


class SimulatedPad:
    """A pad under the simulated hand, and under the pointers of people, if any.

    gestures: what the hand makes, one every `every_s` seconds; a name that is not in PLAYED is a pause.
    on_gesture: called as one begins. on_frame: receives each frame.
    """

    def __init__(
        self,
        rng: RandomState,
        gestures: Sequence[str],
        every_s: float,
        people: Pointers | None = None,
        on_gesture: Callable[[str], None] = lambda gesture: None,
        on_frame: Callable[[Frame], None] = lambda frame: None,
    ) -> None:
        self._rng, self._fabric, self._hands = rng, Fabric(rng), PressingHands(rng)
        self._gestures, self._every_s = itertools.cycle(gestures), every_s
        self._people, self._on_gesture, self._on_frame = people, on_gesture, on_frame
        self._turn = self._play()

    def scan(self, sensor_ms: int) -> Counts:
        """Return the next frame of counts."""
        pointers = self._people.pointers() if self._people else {}
        if self._people and time.monotonic() - self._people.near_s <= ALONE_S:
            # The hand lifts off, and later continues with the next gesture.
            self._turn = self._play()
        elif (own := next(self._turn)) is not None:
            pointers[self] = own
        counts = self._fabric.read(self._hands.frame(pointers))
        self._on_frame(Frame(sensor_ms, time.monotonic(), counts))
        return counts

    def _play(self) -> Iterator[Pointer | None]:
        """Yield where the hand presses, frame by frame: for each gesture a pause and the touch."""
        for gesture in self._gestures:
            touch_s = min(LONGEST_TOUCH_S, self._every_s - SHORTEST_PAUSE_S) if gesture in PLAYED else 0.0
            yield from itertools.repeat(None, round((self._every_s - touch_s) * FRAME_RATE_HZ))
            if gesture in PLAYED:
                self._on_gesture(gesture)
                size, draw = PLAYED[gesture]
                path = draw(self._rng)
                for frame in range(round(touch_s * FRAME_RATE_HZ)):
                    place = path(frame / FRAME_RATE_HZ)
                    yield None if place is None else Pointer(*place, size)
