"""Hands and fingertips that follow pointers: mouse, fingers or pens on the picture of a pad.

A pointer shows where a hand is and when it is down; how firmly it presses follows here from its speed, from
how long it has been down and from what touches. It is set to the contacts in HAART's training recordings on
the uncovered pad, and not to any network's answers. Loads are sums over the pad, in counts above rest:

- Pats last 4 to 7 frames, peak at 101 to 453 counts (10th and 90th percentile) and touch 10 to 37 taxels.
  Palm and fingers do not land at once: consecutive frames correlate by 0.62 to 0.98.
- Strokes reach half of their load in 2 frames, stay at 100 to 140 counts at any speed, end within 6 frames.
  The hand is long: 1.7 taxels along its way at first, 1.4 at the end, 1.75 across (standard deviations).
- Rubs are at 200 counts; their load deviates by 0.45 (as a logarithm), a third of it with the way.
- A resting hand presses down to 650 to 2500 counts, fingertips that scratch with 160 to 190.
"""

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS

Series: TypeAlias = NDArray[np.float64]
# "hand": palm and fingers. "fingertips": those of a hand, under one pointer. "finger": one of several.
Size: TypeAlias = Literal["hand", "fingertips", "finger"]

FRAME_S = 1.0 / FRAME_RATE_HZ
# Limited, so that many viewers do not make frames late.
MOST_PRESSES = 20
# How long a resting and a moving hand take to come off.
LIFT_S, GLIDE_S = 0.055, 0.2
# Share of the way to the pointer, of a new speed and of a new load that a hand takes on in a frame.
FOLLOW, SPEED_SHARE, LOAD_SHARE = 0.6, 0.25, 0.5
# A hand slower than this, in taxels a second, rests; after PAUSE_S it presses down. Time constants of
# pressing down, and of pressing more while it moves.
MOVING_SPEED, PAUSE_S, SINK_S, DWELL_S = 1.2, 0.25, 0.35, 0.45
# A button closes before a hand would land: it lands once the pointer has moved by LANDS_AFTER taxels, after
# LANDS_WITHIN frames, or when the button opens. A hand that has not moved then strikes with its fingers: the
# load of the following frames, as shares of the peak; the latest part, in frames; the share of the load that
# spreads the hand, as the skin has no time to give way.
LANDS_AFTER, LANDS_WITHIN = 0.1, 5
STRIKE, LATEST_PART, STRIKE_SPREADS = (0.6, 1.0, 0.6, 0.35, 0.15), 1.5, 0.3
# Up to this frame a hand that moves as it lands turns into its way, askew by this angle in radians.
AIMED_FRAME, ASKEW = 6, 0.15
# A stroking hand rolls from its palm onto its fingers from FLAT_WAY taxels on. After ROLLED_WAY more it has,
# and has lost the share ROLLED_LIGHTER of its load. One that rests, or has come back by TURN taxels, has
# rolled by REST_ROLLED. ROLL_SHARE: of the way to such a state in a frame.
FLAT_WAY, ROLLED_WAY, ROLLED_LIGHTER = 2.5, 2.5, 0.33
REST_ROLLED, TURN, ROLL_SHARE = 0.7, 0.5, 0.2
# From this speed on, in taxels a second, a hand that pulls towards the wrist presses most.
PULL_SPEED = 8.0
# Deviation of a press's load from that of others, as a logarithm; of a moving hand's load, as fabric sticks
# and slips, and of each of its parts; of a resting hand's; of one that goes to and fro.
FIRMNESS, SLIP, SLIP_OF_PART, TREMOR, SWAY = 0.25, 0.05, 0.5, 0.05, 0.3
# The share of these that the next frame keeps. A moving hand keeps more the slower it is, by 1/e at
# SLIP_SPEED: recorded strokes correlate from frame to frame by 0.83 at 7 taxels a second, and by 0.91 at 2.
SLIP_KEPT, SLIP_SPEED, TREMOR_KEPT, SWAY_KEPT = 0.5, 13.0, 0.98, 0.9
# A part's radius grows with this power of the depth, and is at least this share of its radius at rest, below
# which it would fall between the taxels.
SPREADS, LEAST_RADIUS = 0.2, 0.4


class Pointer(NamedTuple):
    """A pointer that presses. row, column: in taxels, -0.5 to 7.5 from edge to edge.

    pressure: 0 to 1 if the device measures it, else None.
    """

    row: float
    column: float
    size: Size
    pressure: float | None = None


class Part(NamedTuple):
    """A part of a hand: its place along and across it and its radius, in taxels; its share of the force."""

    along: float
    across: float
    radius: float
    share: float


def fingers(count: int) -> list[float]:
    """Return the places of a hand's fingers across it, in taxels."""
    return [0.9 * (finger - (count - 1) / 2) for finger in range(count)]


@dataclass(frozen=True)
class Shape:
    """What touches, with its loads in counts.

    strike: the peak as it lands in one place. struck: after that. light: as it begins to move. firm: after it
    has moved for long. still: at rest. pulls: the share by which it presses more as it comes back towards the
    wrist, and less the other way. uneven: deviation of the parts' loads, as a logarithm.
    """

    parts: tuple[Part, ...]
    strike: float
    struck: float
    light: float
    firm: float
    still: float
    pulls: float
    uneven: float


# The two cushions of the palm, and the root and the tip of each finger.
PALM_AND_FINGERS = (
    *(Part(-2.5, place, 1.2, 0.7) for place in (-1.6, 1.6)),
    *(Part(0.4, place, 0.9, 0.4) for place in (-2.7, -0.9, 0.9, 2.7)),
    *(Part(2.5, place, 0.8, 0.5) for place in (-2.7, -0.9, 0.9, 2.7)),
)
FINGERTIP = Part(0.0, 0.0, 0.6, 1.0)
FINGERTIPS = tuple(FINGERTIP._replace(across=place) for place in fingers(4))
# Part of these loads lies below the noise: each taxel's reading counts from three above its rest.
SHAPES: Mapping[Size, Shape] = {
    "hand": Shape(PALM_AND_FINGERS, 260.0, 40.0, 130.0, 260.0, 1800.0, pulls=0.18, uneven=0.5),
    "fingertips": Shape(FINGERTIPS, 240.0, 30.0, 80.0, 230.0, 600.0, pulls=0.85, uneven=0.9),
    "finger": Shape((FINGERTIP,), 60.0, 8.0, 20.0, 60.0, 150.0, pulls=0.85, uneven=0.0),
}


class PressingHands:
    """The pressure of all pointers, a frame at a time; of at most `MOST_PRESSES`, lifting ones included."""

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
                if len(self._down) + len(self._lifting) >= MOST_PRESSES:
                    continue
                self._down[key] = _Press(pointer, self._rng)
            total += self._down[key].follow(pointer)
        for press in self._lifting:
            total += press.lift()
        self._lifting = [press for press in self._lifting if press.on > 0.0]
        return total


class _Press:
    """One pointer from touching down to lifting off."""

    def __init__(self, pointer: Pointer, rng: RandomState) -> None:
        self._shape = SHAPES[pointer.size]
        self._rng = rng
        self._parts = np.array(self._shape.parts)
        count = len(self._parts)
        # Each hand is held a little differently, and presses in its own way. The fingers point up.
        self._parts[:, 0] += rng.normal(0.0, 0.2 * (count > 1), count)
        self._shares = self._parts[:, 3] * self._parts[:, 2] ** 2
        self._shares *= rng.lognormal(0.0, self._shape.uneven, count)
        self._shares /= self._shares.sum()
        self._firmness = rng.lognormal(0.0, FIRMNESS)
        self._askew = rng.normal(0.0, ASKEW)
        self._heading = -np.pi / 2 + self._askew
        self._at = self._begun = np.array([pointer.row, pointer.column])
        self._velocity = np.zeros(2)
        # The largest distance from where it landed; how far it has rolled onto its fingers, 0 to 1.
        self._way = self._rolled = 0.0
        self._has_turned = False
        # Frames before and since it has landed.
        self._hovered = self._frames = 0
        self._load = self._still_s = self._sway = 0.0
        # How much of it is on the pad, 0 to 1.
        self.on = 1.0
        # When each part strikes, in frames after the first; frames since then, None if it moved as it landed.
        self._delays = rng.uniform(0.0, LATEST_PART, count)
        self._struck: int | None = None
        # Of the whole hand, and of each part.
        self._noise = rng.normal(size=1 + count)

    @property
    def _speed(self) -> float:
        """Taxels a second; 0 for a hand that rests."""
        speed = float(np.hypot(*self._velocity))
        return speed if speed > MOVING_SPEED else 0.0

    def follow(self, pointer: Pointer) -> Series:
        """Move to the pointer and press."""
        place = np.array([pointer.row, pointer.column])
        moved = FOLLOW * (place - self._at)
        self._at = self._at + moved
        self._velocity += SPEED_SHARE * (moved / FRAME_S - self._velocity)
        self._still_s = 0.0 if self._speed else self._still_s + FRAME_S
        has_moved = float(np.hypot(*(place - self._begun))) >= LANDS_AFTER
        self._hovered += 1
        if not (self._frames or has_moved or self._hovered > LANDS_WITHIN):
            return np.zeros((ROWS, COLUMNS))
        self._press(strikes=not has_moved)
        self._aim()
        self._roll()
        self._load += LOAD_SHARE * (self._wanted(pointer) - self._load)
        return self._pressure()

    def lift(self) -> Series:
        """Come off, once a strike is over; a moving hand glides off."""
        self._press(strikes=True)
        if self._struck is None or self._struck >= len(STRIKE):
            self.on = max(0.0, self.on - FRAME_S / (GLIDE_S if self._speed else LIFT_S))
            self._at = self._at + self._velocity * FRAME_S
        return self._pressure()

    def _aim(self) -> None:
        """Turn a hand that moves as it lands into its way, by quarters: fingers abreast, the palm ahead."""
        if self._frames <= AIMED_FRAME and self._speed:
            quarters = np.arctan2(-self._velocity[0], -self._velocity[1]) / (np.pi / 2)
            self._heading = float(np.pi / 2 * np.rint(quarters) + self._askew)

    def _roll(self) -> None:
        """Roll from the palm onto the fingers along a stroke, and back once the hand comes back."""
        way = float(np.hypot(*(self._at - self._begun)))
        self._way = max(self._way, way)
        self._has_turned = self._has_turned or way < self._way - TURN
        goes_on = self._speed and not self._has_turned
        rolled = np.clip((self._way - FLAT_WAY) / ROLLED_WAY, 0.0, 1.0)
        wanted = float(rolled) if goes_on else REST_ROLLED
        self._rolled += ROLL_SHARE * (wanted - self._rolled)

    def _press(self, *, strikes: bool) -> None:
        """Go on by a frame; in the first one, land. strikes: how it lands."""
        if self._frames == 0 and strikes:
            self._struck, self._rolled = -1, 1.0
        if self._struck is not None:
            self._struck += 1
        self._frames += 1

    def _wanted(self, pointer: Pointer) -> float:
        """Return the load that the hand approaches, in counts."""
        shape = self._shape
        firmer = 1.0 - np.exp(-self._frames * FRAME_S / DWELL_S)
        moving = float(shape.light + (shape.firm - shape.light) * firmer)
        if pointer.pressure is not None:
            # Taken for depth; half of a device's range is as firm as a hand that has moved for long.
            return (2.0 * pointer.pressure) ** 2 * shape.firm
        if self._speed or (self._struck is None and self._frames <= AIMED_FRAME):
            if self._has_turned:
                self._sway = SWAY_KEPT * self._sway + math.sqrt(1.0 - SWAY_KEPT**2) * self._rng.normal()
                # The wrist lies below fingertips, to the right.
                pull = float(np.clip(self._velocity.sum() / np.sqrt(2.0) / PULL_SPEED, -1.0, 1.0))
                return moving * math.exp(SWAY * self._sway) * (1.0 + shape.pulls * pull)
            return moving * (1.0 - ROLLED_LIGHTER * self._rolled)
        if self._still_s < PAUSE_S:
            return self._load if self._struck is None else shape.struck
        sunk = 1.0 - np.exp(-(self._still_s - PAUSE_S) / SINK_S)
        return float(moving + (shape.still - moving) * sunk)

    def _pressure(self) -> Series:
        kept = max(SLIP_KEPT, math.exp(-self._speed / SLIP_SPEED)) if self._speed else TREMOR_KEPT
        self._noise = kept * self._noise + np.sqrt(1.0 - kept**2) * self._rng.normal(size=len(self._noise))
        whole, of_part = (SLIP, SLIP_OF_PART) if self._speed else (TREMOR, TREMOR)
        uneven = np.exp(whole * self._noise[0] + of_part * self._noise[1:])
        # Force grows with the square of the depth.
        each = self.on**2 * self._firmness * uneven
        shares = self._shares * np.where(self._parts[:, 0] < 0.0, 1.0 - self._rolled, 1.0)
        strike = np.zeros(len(self._parts))
        if self._struck is not None:
            times = np.arange(-1, len(STRIKE) + 1)
            strike = self._shape.strike * np.interp(self._struck - self._delays, times, (0.0, *STRIKE, 0.0))
        loads = (self._load + strike) * shares / shares.sum() * each
        depth = np.sqrt((self._load + STRIKE_SPREADS * strike) * each / self._shape.still)
        along, across, radius = self._parts[:, 0], self._parts[:, 1], self._parts[:, 2]
        radius = radius * np.maximum(depth**SPREADS, LEAST_RADIUS)
        sine, cosine = np.sin(self._heading), np.cos(self._heading)
        row = self._at[0] + along * sine + across * cosine
        column = self._at[1] + along * cosine - across * sine
        down = np.exp(-0.5 * ((np.arange(ROWS) - row[:, None]) / radius[:, None]) ** 2)
        over = np.exp(-0.5 * ((np.arange(COLUMNS) - column[:, None]) / radius[:, None]) ** 2)
        total: Series = np.einsum("n,nr,nc->rc", loads / (2.0 * np.pi * radius**2), down, over)
        return total
