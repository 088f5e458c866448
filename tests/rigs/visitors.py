"""Touches that visitors of the live page try, and what the simulated pad under their pointers reads."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.random import RandomState

from touchd.daemon.path.events import TouchEnded
from touchd.drivers.fakes.hand import Fabric, Path, constant, pat, stroke, to_and_fro
from touchd.drivers.fakes.pointers import Pointer, PressingHands, Size
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS, Counts
from touchd.model.classifier import Classifier
from touchd.model.studies.play import frames_of, play

REST_S, AFTER_S = 3.0, 2.5
# A browser reports a pointer once for each picture.
PICTURES_HZ = 60.0


class Kind(NamedTuple):
    """A touch that visitors try. gesture: its right name. path: where they press, for some seconds."""

    name: str
    gesture: str
    size: Size
    path: Callable[[RandomState], Path]
    seconds: float


def passes(least_s: float, most_s: float) -> Callable[[RandomState], Path]:
    """Return passes over 55 to 95 % of the pad."""
    return stroke((least_s, most_s), (most_s, most_s), (4.4, 7.6), any_way)


def any_way(rng: RandomState) -> float:
    return float(rng.uniform(0.0, 2.0 * math.pi))


KINDS = (
    Kind("stroke of 0.3 to 0.5 s", "stroke", "hand", passes(0.3, 0.5), 0.5),
    Kind("stroke of 0.5 to 0.7 s", "stroke", "hand", passes(0.5, 0.7), 0.7),
    Kind("stroke of 1 s", "stroke", "hand", passes(0.9, 1.1), 1.1),
    Kind("one pat", "pat", "hand", pat, 0.25),
    Kind("three pats", "pat", "hand", pat, 0.84),
    Kind("rub of 2 s", "rub", "hand", to_and_fro((1.3, 2.3), (1.2, 2.2), any_way), 2.0),
    Kind("still hand", "constant", "hand", constant, 2.0),
    Kind(
        "fingertips, scratching for 2 s",
        "scratch",
        "fingertips",
        to_and_fro((2.5, 4.0), (0.4, 0.9), any_way),
        2.0,
    ),
)


def counts_of(kind: Kind, seed: int) -> Counts:
    """Return what the pad reads at rest, under the touch and after it."""
    rng = RandomState(seed)
    fabric, hands, path = Fabric(rng), PressingHands(rng), kind.path(rng)
    pressed = []
    for frame in range(round((REST_S + kind.seconds + AFTER_S) * FRAME_RATE_HZ)):
        shown_s = math.floor((frame / FRAME_RATE_HZ - REST_S) * PICTURES_HZ) / PICTURES_HZ
        place = path(shown_s) if 0.0 <= shown_s < kind.seconds else None
        # Beyond the edge the hand has left the pad.
        is_on = place and -0.5 <= place[0] <= ROWS - 0.5 and -0.5 <= place[1] <= COLUMNS - 0.5
        pressed.append(hands.frame({0: Pointer(*place, kind.size)} if place and is_on else {}))
    return fabric.read(np.array(pressed))


def named(model: Classifier, counts: Counts) -> str:
    """Return what the daemon calls a touch in the end; several names if it takes it for several."""
    ended = [event for event in play(frames_of(counts), model, flush=True) if isinstance(event, TouchEnded)]
    return ", then ".join(event.gesture for event in ended) or "nothing"
