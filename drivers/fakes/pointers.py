"""Hands and fingertips that follow pointers: mouse, fingers or pens on the picture of a pad.

Forces and sizes start from the simulated hand's. They were chosen with the shipped model on scripted paths:
strokes of 1.2 to 3.2 s, pats, rubs and a still hand.
"""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS

Series: TypeAlias = NDArray[np.float64]
Size: TypeAlias = Literal["hand", "finger"]

FRAME_S = 1.0 / FRAME_RATE_HZ
# Duration of touching down and of lifting off.
EDGE_S = 0.08
# A click shorter than this presses for this long.
SHORTEST_S = 0.08
# Share of the way to the pointer that a hand moves in a frame; of a new speed or force that it takes on.
FOLLOW, SPEED_SHARE, FORCE_SHARE = 0.6, 0.25, 0.15
# A hand slower than this, in taxels a second, rests; after this long it begins to press down, for this long.
MOVING_SPEED = 1.2
PAUSE_S, DWELL_S = 0.15, 0.4
# Fabric sticks and slips: the distance between slips in taxels.
SLIP = 0.5
# A moving hand's pressure rises and falls: by this share, in this time.
SWELL, SWELL_S = 0.75, 1.22
# Noise of the force from frame to frame: at rest, and in addition when moving.
TREMOR, FRICTION = 0.015, 0.6


class Pointer(NamedTuple):
    """What presses now. row, column: in taxels, -0.5 to 7.5 from edge to edge.

    pressure: 0 to 1 if the device measures it, else None: the hand then presses harder where it stays.
    """

    row: float
    column: float
    size: Size
    pressure: float | None = None


@dataclass(frozen=True)
class Shape:
    """The parts of a hand, (N,) each: place along and across it and radius, in taxels; share of the force.

    landing, still: counts as it comes down, and where it stays. slow, fast: counts when moving, and more for
    each taxel a second.
    """

    along: Series
    across: Series
    radius: Series
    share: Series
    landing: float
    still: float
    slow: float
    fast: float


# Palm and four fingers.
HAND = Shape(
    along=np.array([-0.3, 0.3, 0.3, 0.3, 0.3]),
    across=np.array([0.0, -1.76, -0.59, 0.59, 1.76]),
    radius=np.array([1.83, 0.82, 0.82, 0.82, 0.82]),
    share=np.array([0.05, 0.57, 0.57, 0.57, 0.57]),
    landing=7.3,
    still=30.0,
    slow=4.0,
    fast=1.34,
)
FINGER = Shape(
    along=np.zeros(1),
    across=np.zeros(1),
    radius=np.array([0.6]),
    share=np.ones(1),
    landing=15.0,
    still=60.0,
    slow=20.0,
    fast=3.0,
)
SHAPES: Mapping[Size, Shape] = {"hand": HAND, "finger": FINGER}


class PressingHands:
    """The pressure of all pointers, a frame at a time."""

    def __init__(self, rng: RandomState) -> None:
        self._rng = rng
        self._down: dict[Hashable, _Press] = {}
        self._lifting: list[_Press] = []

    def frame(self, pointers: Mapping[Hashable, Pointer]) -> Series:
        """Return counts of pressure (8, 8) for the next frame. pointers: what presses now, by identity."""
        total = np.zeros((ROWS, COLUMNS))
        for key in [key for key in self._down if key not in pointers]:
            self._lifting.append(self._down.pop(key))
        for key, pointer in pointers.items():
            if key not in self._down:
                self._down[key] = _Press(pointer, self._rng)
            total += self._down[key].follow(pointer)
        for press in self._lifting:
            total += press.lift()
        self._lifting = [press for press in self._lifting if press.is_touching]
        return total


class _Press:
    """One pointer from touching down to lifting off."""

    def __init__(self, pointer: Pointer, rng: RandomState) -> None:
        self._shape = SHAPES[pointer.size]
        self._rng = rng
        parts = len(self._shape.share)
        spread = 0.2 if parts > 1 else 0.0
        self._along = self._shape.along + rng.normal(0.0, spread, parts)
        self._share = self._shape.share * (rng.uniform(0.5, 1.5, parts) if parts > 1 else 1.0)
        self._at = self._stuck_at = np.array([pointer.row, pointer.column])
        self._velocity = np.zeros(2)
        self._heading = -np.pi / 2 + rng.normal(0.0, 0.3)
        self._force = self._shape.landing
        self._swell = rng.uniform(0.0, 0.3)
        self._still_s = self._down_s = self._edge = 0.0

    @property
    def is_touching(self) -> bool:
        return self._edge > 0.0

    def follow(self, pointer: Pointer) -> Series:
        """Move to the pointer and press."""
        self._down_s += FRAME_S
        self._edge = min(1.0, self._edge + FRAME_S / EDGE_S)
        moved = FOLLOW * (np.array([pointer.row, pointer.column]) - self._at)
        self._at = self._at + moved
        self._velocity += SPEED_SHARE * (moved / FRAME_S - self._velocity)
        speed = float(np.hypot(*self._velocity))
        is_moving = speed > MOVING_SPEED
        self._still_s = 0.0 if is_moving else self._still_s + FRAME_S
        if is_moving:
            # The palm leads and the fingers follow, as when a hand is drawn towards oneself.
            self._heading = float(np.arctan2(-self._velocity[0], -self._velocity[1]))
            self._swell += FRAME_S / SWELL_S
        if not is_moving or np.hypot(*(self._at - self._stuck_at)) >= SLIP:
            self._stuck_at = self._at
        self._force += FORCE_SHARE * (self._wanted(pointer, speed if is_moving else 0.0) - self._force)
        return self._pressure(is_moving)

    def lift(self) -> Series:
        """Come off, once the shortest press is over."""
        self._down_s += FRAME_S
        step = FRAME_S / EDGE_S
        if self._down_s <= SHORTEST_S:
            self._edge = min(1.0, self._edge + step)
        else:
            self._edge = max(0.0, self._edge - step)
        return self._pressure(is_moving=False)

    def _wanted(self, pointer: Pointer, speed: float) -> float:
        shape = self._shape
        moving = shape.slow + shape.fast * speed
        if pointer.pressure is not None:
            # Half of a device's range is as firm as a hand that neither rests nor moves.
            return 2.0 * pointer.pressure * max(shape.landing, moving)
        if speed > 0.0:
            return moving
        if self._still_s <= PAUSE_S:
            return self._force
        return shape.slow + (shape.still - shape.slow) * min(1.0, (self._still_s - PAUSE_S) / DWELL_S)

    def _pressure(self, is_moving: bool) -> Series:
        noise = self._rng.normal(size=len(self._share))
        unsteady = TREMOR + (FRICTION if is_moving else 0.0)
        ease = SWELL * (0.5 + 0.5 * np.cos(2.0 * np.pi * self._swell)) if is_moving else 0.0
        # A soft hand on a soft pad: force grows with the square of the depth.
        force = self._edge**2 * self._force * (1.0 - ease)
        forces = force * self._share * np.maximum(0.0, 1.0 + unsteady * noise)
        sine, cosine = np.sin(self._heading), np.cos(self._heading)
        row = self._stuck_at[0] + self._along * sine + self._shape.across * cosine
        column = self._stuck_at[1] + self._along * cosine - self._shape.across * sine
        down = np.exp(-0.5 * ((np.arange(ROWS) - row[:, None]) / self._shape.radius[:, None]) ** 2)
        over = np.exp(-0.5 * ((np.arange(COLUMNS) - column[:, None]) / self._shape.radius[:, None]) ** 2)
        total: Series = np.einsum("n,nr,nc->rc", forces, down, over)
        return total
