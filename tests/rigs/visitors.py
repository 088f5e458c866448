"""Touches that visitors of the live page try, and what the simulated pad under their pointers reads."""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.random import RandomState

from touchd.daemon.path.events import TouchEnded
from touchd.drivers.fakes.hand import Fabric
from touchd.drivers.fakes.pointers import Pointer, PressingHands, Size
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS, Counts
from touchd.model.classifier import Classifier
from touchd.model.studies.play import frames_of, play

REST_S, AFTER_S = 3.0, 2.5
# A browser reports a pointer once for each picture.
PICTURES_HZ = 60.0

# Where pointers press after a time in seconds, as shares of the pad's width and height, and when they lift.
Places: TypeAlias = Callable[[float], list[tuple[float, float]]]
Routes: TypeAlias = Callable[[RandomState], tuple[Places, float]]


class Kind(NamedTuple):
    """A touch that visitors try. gesture: its right name. make: returns its places and length in seconds."""

    name: str
    gesture: str
    size: Size
    make: Routes


def stroke(shortest_s: float, longest_s: float) -> Routes:
    """Return passes over 55 to 95 % of the pad in any direction, which begin and end in motion."""

    def make(rng: RandomState) -> tuple[Places, float]:
        seconds, length = rng.uniform(shortest_s, longest_s), rng.uniform(0.55, 0.95)
        heading, bend = rng.uniform(0.0, 2.0 * math.pi), rng.normal(0.0, 0.05)
        row, column = rng.uniform(0.45, 0.55, 2)

        def places(time_s: float) -> list[tuple[float, float]]:
            part = time_s / seconds
            # Half of the speed changes on the way: slower at the ends, faster in the middle.
            along = length * (part - 0.5 - 0.5 * math.sin(2.0 * math.pi * part) / (2.0 * math.pi))
            across = bend * math.sin(math.pi * part)
            return [
                (
                    row + along * math.sin(heading) + across * math.cos(heading),
                    column + along * math.cos(heading) - across * math.sin(heading),
                )
            ]

        return places, seconds

    return make


def pats(count: int) -> Routes:
    """Return clicks of 0.08 to 0.2 s in one place, about three a second."""

    def make(rng: RandomState) -> tuple[Places, float]:
        row, column = rng.uniform(0.3, 0.7, 2)
        down_s, every_s = rng.uniform(0.08, 0.2), rng.uniform(0.28, 0.4)

        def places(time_s: float) -> list[tuple[float, float]]:
            return [(row, column)] if time_s % every_s < down_s else []

        return places, (count - 1) * every_s + down_s

    return make


def rub(rng: RandomState) -> tuple[Places, float]:
    """Return a movement to and fro over a third to a half of the pad."""
    pace_hz, reach = rng.uniform(1.3, 2.3), rng.uniform(0.15, 0.28)
    heading, phase = rng.uniform(0.0, math.pi), rng.choice([0.0, math.pi])

    def places(time_s: float) -> list[tuple[float, float]]:
        along = reach * math.cos(2.0 * math.pi * pace_hz * time_s + phase)
        return [(0.5 + along * math.sin(heading), 0.5 + along * math.cos(heading))]

    return places, 2.0


def still_hand(rng: RandomState) -> tuple[Places, float]:
    """A pointer that is held in one place."""
    row, column = rng.uniform(0.4, 0.6, 2)
    return (lambda time_s: [(row, column)]), rng.uniform(1.0, 3.0)


def scratching(rng: RandomState) -> tuple[Places, float]:
    """Return short quick pulls in one place."""
    pace_hz, reach = rng.uniform(2.5, 4.0), rng.uniform(0.05, 0.11)
    heading = rng.uniform(0.0, math.pi)
    row, column = rng.uniform(0.4, 0.6, 2)

    def places(time_s: float) -> list[tuple[float, float]]:
        along = reach * math.cos(2.0 * math.pi * pace_hz * time_s)
        return [(row + along * math.sin(heading), column + along * math.cos(heading))]

    return places, 2.0


KINDS = (
    Kind("stroke of 0.3 to 0.5 s", "stroke", "hand", stroke(0.3, 0.5)),
    Kind("stroke of 0.5 to 0.7 s", "stroke", "hand", stroke(0.5, 0.7)),
    Kind("stroke of 1 s", "stroke", "hand", stroke(0.9, 1.1)),
    Kind("one pat", "pat", "hand", pats(1)),
    Kind("three pats", "pat", "hand", pats(3)),
    Kind("rub of 2 s", "rub", "hand", rub),
    Kind("still hand", "constant", "hand", still_hand),
    Kind("fingertips, scratching for 2 s", "scratch", "fingertips", scratching),
)


def counts_of(kind: Kind, seed: int) -> Counts:
    """Return what the pad reads at rest, under the touch and after it."""
    rng = RandomState(seed)
    fabric, hands = Fabric(rng), PressingHands(rng)
    places, seconds = kind.make(rng)
    pressed = []
    for frame in range(round((REST_S + seconds + AFTER_S) * FRAME_RATE_HZ)):
        time_s = frame / FRAME_RATE_HZ - REST_S
        shown_s = math.floor(time_s * PICTURES_HZ) / PICTURES_HZ
        at = places(shown_s) if 0.0 <= shown_s < seconds else []
        pressing = {
            number: Pointer(ROWS * row - 0.5, COLUMNS * column - 0.5, kind.size)
            for number, (row, column) in enumerate(at)
            if 0.0 <= row <= 1.0 and 0.0 <= column <= 1.0
        }
        pressed.append(hands.frame(pressing))
    return fabric.read(np.array(pressed))


def named(model: Classifier, counts: Counts) -> str:
    """Return what the daemon calls a touch in the end; several names if it takes it for several."""
    ended = [event for event in play(frames_of(counts), model, flush=True) if isinstance(event, TouchEnded)]
    return ", then ".join(event.gesture for event in ended) or "nothing"
