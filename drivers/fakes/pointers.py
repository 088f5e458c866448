"""Simulates the pressure of hands that follow pointers: a mouse, fingers or pens on the picture of a pad.

A pointer gives a hand's place and whether it is down. Its load follows from its speed, from how long it has
been down, and from what touches. The model is fitted to the contacts in HAART's training recordings on the
uncovered pad, not to any network's answers. Loads are sums over the pad, in counts above rest:

- Pats last 4 to 7 frames, peak at 101 to 453 counts (10th and 90th percentile) and touch 10 to 37 taxels.
  Palm and fingers do not land at once: consecutive frames correlate by 0.62 to 0.98.
- Strokes reach half of their load in 2 frames, keep 100 to 140 counts at any speed, and end within 6 frames.
  Their contact spreads by 1.7 taxels along the stroke at first and 1.4 at the end, and by 1.75 across it
  (standard deviations).
- Rubs have a load of 200 counts. Its logarithm deviates by 0.45, a third of it with the direction.
- A resting hand sinks in to 650 to 2500 counts; fingertips scratch with 160 to 190.
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
# "hand": palm and fingers. "fingertips": those of one hand, under one pointer. "finger": a single fingertip.
Size: TypeAlias = Literal["hand", "fingertips", "finger"]

FRAME_S = 1.0 / FRAME_RATE_HZ
# Limits the work of a frame, so that many viewers do not delay it.
MOST_PRESSES = 20
# How long a resting and a moving hand take to lift off.
LIFT_S, GLIDE_S = 0.055, 0.2
# Low-pass filters, as shares of the difference that a frame takes over: of place, speed and load.
FOLLOW, SPEED_SHARE, LOAD_SHARE = 0.6, 0.25, 0.5
# A hand rests below this speed, in taxels a second, and sinks in after PAUSE_S. SINK_S, DWELL_S: time
# constants with which the load of a resting and of a moving hand grows.
MOVING_SPEED, PAUSE_S, SINK_S, DWELL_S = 1.2, 0.25, 0.35, 0.45
# A mouse button closes before a hand would land. So the hand lands once the pointer has moved by LANDS_AFTER
# taxels, after LANDS_WITHIN frames, or when the button opens.
LANDS_AFTER, LANDS_WITHIN = 0.1, 5
# A hand that lands without moving strikes, as in a pat. STRIKE: its load in the following frames, as shares
# of the peak. LATEST_PART: the largest delay of a part of the hand, in frames. STRIKE_SPREADS: the share of
# the load that widens the contact, as the skin has no time to give way.
STRIKE, LATEST_PART, STRIKE_SPREADS = (0.6, 1.0, 0.6, 0.35, 0.15), 1.5, 0.3
# A hand that moves as it lands turns into its direction up to this frame, askew by this angle (deviation, in
# radians).
AIMED_FRAME, ASKEW = 6, 0.15
# A stroking hand rolls from its palm onto its fingers between FLAT_WAY and FLAT_WAY + ROLLED_WAY taxels, and
# then has lost the share ROLLED_LIGHTER of its load. A hand that rests, or has come back by TURN taxels, is
# rolled by REST_ROLLED. ROLL_SHARE: a low-pass filter, as above.
FLAT_WAY, ROLLED_WAY, ROLLED_LIGHTER = 2.5, 2.5, 0.33
REST_ROLLED, TURN, ROLL_SHARE = 0.7, 0.5, 0.2
# The speed towards the wrist, in taxels a second, at which a hand presses most.
PULL_SPEED = 8.0
# Random variation of the load (deviation of its logarithm): from press to press; of a moving hand, as fabric
# sticks and slips, and of each of its parts; of a resting hand; of a hand that moves to and fro.
FIRMNESS, SLIP, SLIP_OF_PART, TREMOR, SWAY = 0.25, 0.05, 0.5, 0.05, 0.3
# Its correlation from frame to frame. That of a moving hand falls with speed, to 1/e at SLIP_SPEED: recorded
# strokes correlate by 0.91 at 2 taxels a second, by 0.83 at 7.
SLIP_KEPT, SLIP_SPEED, TREMOR_KEPT, SWAY_KEPT = 0.5, 13.0, 0.98, 0.9
# The radius of a part grows with this power of the depth, from at least this share of its radius at rest; a
# smaller part would fall between the taxels.
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

    strike: the peak of a strike; struck: after it. light: of a hand that begins to move; firm: that has moved
    for long; still: that rests. pulls: the share by which it presses more towards the wrist, and less the
    other way. uneven: deviation of the logarithm of the parts' loads.
    """

    parts: tuple[Part, ...]
    strike: float
    struck: float
    light: float
    firm: float
    still: float
    pulls: float
    uneven: float


# The two balls of the palm, and the root and tip of each finger.
PALM_AND_FINGERS = (
    *(Part(-2.5, place, 1.2, 0.7) for place in (-1.6, 1.6)),
    *(Part(0.4, place, 0.9, 0.4) for place in (-2.7, -0.9, 0.9, 2.7)),
    *(Part(2.5, place, 0.8, 0.5) for place in (-2.7, -0.9, 0.9, 2.7)),
)
FINGERTIP = Part(0.0, 0.0, 0.6, 1.0)
FINGERTIPS = tuple(FINGERTIP._replace(across=place) for place in fingers(4))
# Part of these loads lies below the noise: in recordings, a taxel counts from three counts above its rest.
SHAPES: Mapping[Size, Shape] = {
    "hand": Shape(PALM_AND_FINGERS, 260.0, 40.0, 130.0, 260.0, 1800.0, pulls=0.18, uneven=0.5),
    "fingertips": Shape(FINGERTIPS, 240.0, 30.0, 80.0, 230.0, 600.0, pulls=0.85, uneven=0.9),
    "finger": Shape((FINGERTIP,), 60.0, 8.0, 20.0, 60.0, 150.0, pulls=0.85, uneven=0.0),
}


class PressingHands:
    """The pressure of all pointers, frame by frame: at most `MOST_PRESSES`, including those that lift."""

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
        # Hands differ in shape and in how their parts press. The fingers point up.
        self._parts[:, 0] += rng.normal(0.0, 0.2 * (count > 1), count)
        self._shares = self._parts[:, 3] * self._parts[:, 2] ** 2
        self._shares *= rng.lognormal(0.0, self._shape.uneven, count)
        self._shares /= self._shares.sum()
        self._firmness = rng.lognormal(0.0, FIRMNESS)
        self._askew = rng.normal(0.0, ASKEW)
        self._heading = -np.pi / 2 + self._askew
        self._at = self._begun = np.array([pointer.row, pointer.column])
        self._velocity = np.zeros(2)
        # The largest distance from the landing place; how far it has rolled onto its fingers, 0 to 1.
        self._way = self._rolled = 0.0
        self._has_turned = False
        # Frames before and since it has landed.
        self._hovered = self._frames = 0
        self._load = self._still_s = self._sway = 0.0
        # How much of it is on the pad, 0 to 1.
        self.on = 1.0
        # Each part's delay in a strike, in frames; frames since the strike, None if it moved as it landed.
        self._delays = rng.uniform(0.0, LATEST_PART, count)
        self._struck: int | None = None
        # Variation of the load of the whole hand, and of each part.
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
        """Lift off, once a strike is over; a moving hand glides off."""
        self._press(strikes=True)
        if self._struck is None or self._struck >= len(STRIKE):
            self.on = max(0.0, self.on - FRAME_S / (GLIDE_S if self._speed else LIFT_S))
            self._at = self._at + self._velocity * FRAME_S
        return self._pressure()

    def _aim(self) -> None:
        """Turn a hand that moves as it lands into its direction, in quarters of a turn."""
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
        """Count a frame; in the first one, land. strikes: whether it lands without moving."""
        if self._frames == 0 and strikes:
            self._struck, self._rolled = -1, 1.0
        if self._struck is not None:
            self._struck += 1
        self._frames += 1

    def _wanted(self, pointer: Pointer) -> float:
        """Return the load that the low-pass filter approaches, in counts."""
        shape = self._shape
        firmer = 1.0 - np.exp(-self._frames * FRAME_S / DWELL_S)
        moving = float(shape.light + (shape.firm - shape.light) * firmer)
        if pointer.pressure is not None:
            # Read as depth: half of a device's range gives the load of a hand that has moved for long.
            return (2.0 * pointer.pressure) ** 2 * shape.firm
        if self._speed or (self._struck is None and self._frames <= AIMED_FRAME):
            if self._has_turned:
                self._sway = SWAY_KEPT * self._sway + math.sqrt(1.0 - SWAY_KEPT**2) * self._rng.normal()
                # The wrist is below the fingertips and to the right.
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
