"""What the hand of `touchd fake-pad` does: gestures of the hand under a pointer, one after another."""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.random import RandomState

from touchd.drivers.fakes.pointers import Pointer, PressingHands, Series, Size
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, NO_TOUCH, ROWS

# Longest touch of a repeated gesture, and the shortest pause, which ends a touch.
LONGEST_TOUCH_S, SHORTEST_PAUSE_S = 3.8, 1.5
# People move up and down the pad: in 313 of 380 recorded strokes and 253 of 260 seconds of rubbing. Deviation
# from that, in radians.
ASLANT = 0.35
# Until the hand has come off.
LIFTING_S = 0.3
MIDDLE = (ROWS - 1) / 2

# Where the hand is, in taxels, at a time in seconds; None: off the pad.
Path: TypeAlias = Callable[[float], tuple[float, float] | None]


class Gesture(NamedTuple):
    """A gesture, with what touches and its paths, each a different one."""

    size: Size
    path: Callable[[RandomState], Path]


def middle(rng: RandomState) -> tuple[float, float]:
    """Return a place near the middle of the pad."""
    row, column = rng.normal(MIDDLE, 0.5, 2)
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


def stroke(rng: RandomState) -> Path:
    """Stroke about once a second, over half of the pad or more, always the same way."""
    (row, column), heading = middle(rng), up_or_down(rng)
    down_s, every_s, length = rng.uniform(0.4, 0.7), rng.uniform(0.85, 1.2), rng.uniform(4.0, 6.5)

    def path(time_s: float) -> tuple[float, float] | None:
        part = time_s % every_s / down_s
        if part >= 1.0:
            return None
        # Slower at the ends, faster in the middle, moving throughout.
        along = length * (part - 0.5 - 0.25 * math.sin(2.0 * math.pi * part) / math.pi)
        return row + along * math.sin(heading), column + along * math.cos(heading)

    return path


def to_and_fro(least_hz: float, most_hz: float, least: float, most: float) -> Callable[[RandomState], Path]:
    """Return back-and-forth paths; pace in Hz and reach in taxels are drawn from these ranges."""

    def make(rng: RandomState) -> Path:
        (row, column), heading = middle(rng), up_or_down(rng)
        pace_hz, reach = rng.uniform(least_hz, most_hz), rng.uniform(least, most)

        def path(time_s: float) -> tuple[float, float]:
            along = reach * math.cos(2.0 * math.pi * pace_hz * time_s)
            return row + along * math.sin(heading), column + along * math.cos(heading)

        return path

    return make


# With the paces and ways of HAART's recordings. No hand here tickles as people do, so none is played.
PLAYED: Mapping[str, Gesture] = {
    "constant": Gesture("hand", constant),
    "pat": Gesture("hand", pat),
    "rub": Gesture("hand", to_and_fro(1.2, 2.2, 0.7, 1.9)),
    "scratch": Gesture("fingertips", to_and_fro(2.5, 4.0, 0.4, 0.9)),
    "stroke": Gesture("hand", stroke),
}


def played(gesture: str, seconds: float, rng: RandomState) -> Series:
    """Return the pressure (T, 8, 8) of a touch, performed a little differently each time."""
    hands, (size, make) = PressingHands(rng), PLAYED[gesture]
    path = make(rng)
    pressed = []
    for frame in range(round((seconds + LIFTING_S) * FRAME_RATE_HZ)):
        time_s = frame / FRAME_RATE_HZ
        place = path(time_s) if time_s < seconds else None
        pressed.append(hands.frame({} if place is None else {"hand": Pointer(*place, size)}))
    return np.array(pressed)


def repeated(gestures: Sequence[str], every_s: float, rng: RandomState) -> Iterator[tuple[str, Series]]:
    """Cycle through the gestures, one every `every_s` seconds."""
    touch_s = min(LONGEST_TOUCH_S, every_s - SHORTEST_PAUSE_S)
    for gesture in itertools.cycle(gestures):
        pause_s = every_s - touch_s - LIFTING_S if gesture in PLAYED else every_s
        yield NO_TOUCH, np.zeros((round(pause_s * FRAME_RATE_HZ), ROWS, COLUMNS))
        if gesture in PLAYED:
            yield gesture, played(gesture, touch_s, rng)
