"""Hands and fingertips that follow pointers: mouse, fingers or pens on the picture of a pad.

The hand has the simulated hand's palm and fingers, and leans on the palm. Its forces are set to match load,
peak and area of HAART's still hands, pats, repeated strokes and rubs on the bare pad.

In the recordings of both studies on fabric, slower passes are firmer, and the load swells along the way: a
hand drawn one way sinks in as it goes. Here, a stroke's peak and second half match slow recorded passes. Its
contact is smaller than theirs and swells later: this was chosen with the shipped network, which is unsure of
most recorded passes if they are cut out one at a time.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from touchd.drivers.fakes.hand import FLAT_HAND, Part
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS

Series: TypeAlias = NDArray[np.float64]
Size: TypeAlias = Literal["hand", "finger"]

FRAME_S = 1.0 / FRAME_RATE_HZ
# Limited, so that many viewers do not make frames late.
MOST_PRESSES = 20
# Duration of touching down, and of lifting off for a hand that rests and for one that moves.
EDGE_S, LIFT_S, GLIDE_S = 0.08, 0.08, 0.4
# A click shorter than this presses for this long.
SHORTEST_S = 0.08
# In a frame: the share of the way to the pointer that a hand moves, and the share of a new speed it takes on.
FOLLOW, SPEED_SHARE = 0.6, 0.25
# Share of a new force that a resting and a moving hand take on in a frame.
PRESS_SHARE, EASE_SHARE = 0.25, 0.1
# A hand slower than this, in taxels a second, rests. After PAUSE_S it begins to press down, over DWELL_S.
MOVING_SPEED = 1.2
PAUSE_S, DWELL_S = 0.15, 0.4
# A hand that comes back by this many taxels no longer strokes: it rubs or scratches.
TURN = 0.3
# A stroking hand rolls from flat onto its fingertips within this time.
ROLL_S = 0.2
# A stroke is firmest after this distance, in taxels; it begins with this share of its force. Recorded loads
# rise over the first third to half of a pass, however long it takes.
SWELL, FIRST_SHARE = 4.0, 0.15
# A stroke slower than this, in taxels a second, is firm. In the recordings the median peak of a pass is 14
# counts above 6 taxels a second and 26 below.
FIRM_SPEED = 5.0
# Noise of a resting hand's force, as a share of it; the share of the noise that the next frame keeps.
TREMOR, KEPT_NOISE = 0.015, 0.5


class Pointer(NamedTuple):
    """A pointer that presses. row, column: in taxels, -0.5 to 7.5 from edge to edge.

    pressure: 0 to 1 if the device measures it, else None: the hand then presses harder where it stays.
    """

    row: float
    column: float
    size: Size
    pressure: float | None = None


@dataclass(frozen=True)
class Shape:
    """A hand or a fingertip, as parts with a place and a share of the force.

    tips: the parts while it strokes. landing, still, stroke: force in counts as it comes down, where it
    stays, and where a slow stroke is firmest. slow, fast: force when it moves to and fro, and what each taxel
    a second adds. slip: how much a part's force then varies, in counts, as fabric sticks and slips.
    """

    parts: tuple[Part, ...]
    tips: tuple[Part, ...]
    landing: float
    still: float
    stroke: float
    slow: float
    fast: float
    slip: float


def flat_hand_with(shares: Sequence[float], **changed: float) -> tuple[Part, ...]:
    """Return the flat hand with other shares of the force. changed: fields that change for every part."""
    return tuple(part._replace(share=share, **changed) for part, share in zip(FLAT_HAND, shares, strict=True))


FINGERTIP = Part(0.0, 0.0, 0.6, 1.0)
# Thin fingertips in a row, because the network is surest of them.
FOUR_TIPS = flat_hand_with((0.0, 0.8, 1.0, 1.0, 0.8), along=0.0, radius=0.45)
# With the fingers as firm as the palm, the network takes rubs for scratches.
LEANING_HAND = flat_hand_with((1.3, 0.3, 0.3, 0.3, 0.3))
HAND = Shape(LEANING_HAND, FOUR_TIPS, landing=12.0, still=30.0, stroke=25.0, slow=3.0, fast=0.6, slip=2.0)
FINGER = Shape(
    (FINGERTIP,), (FINGERTIP,), landing=25.0, still=60.0, stroke=45.0, slow=20.0, fast=3.0, slip=8.0
)
SHAPES: Mapping[Size, Shape] = {"hand": HAND, "finger": FINGER}


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
        self._lifting = [press for press in self._lifting if press.is_touching]
        return total


class _Press:
    """One pointer from touching down to lifting off."""

    def __init__(self, pointer: Pointer, rng: RandomState) -> None:
        self._shape = SHAPES[pointer.size]
        self._rng = rng
        flat, tips = (np.array(parts) for parts in (self._shape.parts, self._shape.tips))
        # The fingers of a hand press unevenly, each hand in its own way; a fingertip has one part.
        uneven = len(flat) > 1
        bent = rng.normal(0.0, 0.2 * uneven, len(flat))
        strength = 1.0 + 0.5 * uneven * rng.uniform(-1.0, 1.0, len(flat))
        # A row for each part: along, across, radius, share.
        for parts in (flat, tips):
            parts[:, 0] += bent
            parts[:, 3] *= strength
        self._flat, self._tips = flat, tips
        self._noise = np.zeros(len(flat))
        self._at = self._landed = np.array([pointer.row, pointer.column])
        self._velocity = np.zeros(2)
        self._heading = -np.pi / 2 + rng.normal(0.0, 0.3)
        self._force = self._still_s = self._down_s = self._edge = 0.0
        # The largest distance from where it landed; how far it has rolled onto its fingertips, 0 to 1.
        self._way = self._rolled = 0.0
        self._has_turned = self._is_stroking = False

    @property
    def is_touching(self) -> bool:
        return self._edge > 0.0

    @property
    def _speed(self) -> float:
        """Taxels a second; 0 for a hand that rests."""
        speed = float(np.hypot(*self._velocity))
        return speed if speed > MOVING_SPEED else 0.0

    def follow(self, pointer: Pointer) -> Series:
        """Move to the pointer and press."""
        self._down_s += FRAME_S
        self._edge = min(1.0, self._edge + FRAME_S / EDGE_S)
        moved = FOLLOW * (np.array([pointer.row, pointer.column]) - self._at)
        self._at = self._at + moved
        self._velocity += SPEED_SHARE * (moved / FRAME_S - self._velocity)
        self._still_s = 0.0 if self._speed else self._still_s + FRAME_S
        self._notice_stroke()
        if self._speed and not self._is_stroking:
            # The palm leads and the fingers follow, as when a hand is drawn towards oneself.
            self._heading = float(np.arctan2(-self._velocity[0], -self._velocity[1]))
        share = EASE_SHARE if self._speed and not self._is_stroking else PRESS_SHARE
        self._force += share * (self._wanted(pointer) - self._force)
        return self._pressure()

    def _notice_stroke(self) -> None:
        """Note whether the hand strokes: it moves away from where it landed, and has never come back."""
        way = float(np.hypot(*(self._at - self._landed)))
        self._way = max(self._way, way)
        self._has_turned = self._has_turned or way < self._way - TURN
        goes_on = self._speed > 0.0 or (self._is_stroking and self._still_s <= PAUSE_S)
        self._is_stroking = goes_on and not self._has_turned
        step = FRAME_S / ROLL_S
        self._rolled = float(np.clip(self._rolled + (step if self._is_stroking else -step), 0.0, 1.0))

    def lift(self) -> Series:
        """Come off, once the shortest press is over; a moving hand glides off."""
        self._down_s += FRAME_S
        if self._down_s <= SHORTEST_S:
            self._edge = min(1.0, self._edge + FRAME_S / EDGE_S)
        else:
            self._edge = max(0.0, self._edge - FRAME_S / (GLIDE_S if self._speed else LIFT_S))
            self._at = self._at + self._velocity * FRAME_S
        return self._pressure()

    def _wanted(self, pointer: Pointer) -> float:
        """Return the force that the hand approaches, in counts."""
        shape = self._shape
        moving = shape.slow + shape.fast * self._speed
        if pointer.pressure is not None:
            # Half of a device's range is as firm as a hand that neither rests nor moves.
            return 2.0 * pointer.pressure * max(shape.landing, moving)
        if self._is_stroking:
            # The hand sinks in as it goes; force grows with the square of the depth.
            swell = max(FIRST_SHARE, min(1.0, self._way / SWELL) ** 2)
            return shape.stroke * swell * min(1.0, FIRM_SPEED * self._down_s / max(self._way, FRAME_S))
        if self._speed:
            return moving
        if self._still_s <= PAUSE_S:
            return shape.landing if self._still_s == self._down_s else self._force
        firm = min(1.0, (self._still_s - PAUSE_S) / DWELL_S)
        return moving + (shape.still - moving) * firm

    def _pressure(self) -> Series:
        kept = KEPT_NOISE
        self._noise = kept * self._noise + np.sqrt(1.0 - kept**2) * self._rng.normal(size=len(self._noise))
        slips = self._speed > 0.0 and not self._is_stroking
        uneven = TREMOR * self._force + (self._shape.slip if slips else 0.0)
        along, across, radius, share = (self._flat + self._rolled * (self._tips - self._flat)).T
        # A soft hand on a soft pad: force grows with the square of the depth.
        forces = self._edge**2 * share * np.maximum(0.0, self._force + uneven * self._noise)
        sine, cosine = np.sin(self._heading), np.cos(self._heading)
        row = self._at[0] + along * sine + across * cosine
        column = self._at[1] + along * cosine - across * sine
        down = np.exp(-0.5 * ((np.arange(ROWS) - row[:, None]) / radius[:, None]) ** 2)
        over = np.exp(-0.5 * ((np.arange(COLUMNS) - column[:, None]) / radius[:, None]) ** 2)
        total: Series = np.einsum("n,nr,nc->rc", forces, down, over)
        return total
