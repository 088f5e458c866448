"""Simulates touches that are none of the gestures, for training: blows, squeezes, objects, a sleeve.

Nobody has recorded such touches on the fabric pads. Each maker below simulates one kind of touch by its
physics, with random parameters, and returns its counts above rest.
"""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, OTHER, ROWS
from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.adapt.passing import WINDOW_FRAMES, InPassing

Floats = NDArray[np.float64]
Maker = Callable[[Generator, int], Floats]
"""Takes a random generator and a number of frames T; returns counts above rest (T, 8, 8) from the onset."""

ROW, COLUMN = np.mgrid[0:ROWS, 0:COLUMNS].astype(np.float64)
# Taxels differ in sensitivity: the standard deviation of its logarithm.
UNEVEN = 0.2
# Rest after a simulated touch.
AFTER_FRAMES = 60


def spot(row: Floats, column: Floats, along: float, across: float, turned: Floats | float = 0.0) -> Floats:
    """Return (T, 8, 8): a Gaussian of height 1 at places (T,); along, across: its deviations in taxels."""
    angle = np.broadcast_to(np.asarray(turned, np.float64), row.shape)[:, None, None]
    down, over = ROW - row[:, None, None], COLUMN - column[:, None, None]
    first, second = down * np.sin(angle) + over * np.cos(angle), down * np.cos(angle) - over * np.sin(angle)
    shape: Floats = np.exp(-0.5 * ((first / along) ** 2 + (second / across) ** 2))
    return shape


def smooth(rng: Generator, frames: int, fastest_hz: float) -> Floats:
    """Return smooth noise (T,) of about unit deviation, as of a hand's tremor."""
    hz = fastest_hz * rng.uniform(0.1, 1.0, 5)
    phases = 2.0 * math.pi * (np.outer(np.arange(frames) / FRAME_RATE_HZ, hz) + rng.uniform(size=5))
    noise: Floats = math.sqrt(2.0 / 5.0) * np.sin(phases).sum(axis=1)
    return noise


def press(frames: int, first: float, last: float, rise: float, fall: float) -> Floats:
    """Return the force (T,) of a press between two frames, which rises from 0 to 1 and falls to 0."""
    ticks = np.arange(frames)
    force: Floats = np.minimum((ticks - first + 1.0) / rise, (last - ticks) / fall).clip(0.0, 1.0)
    return force


def seconds(rng: Generator, least: float, most: float) -> float:
    """Return a random duration in frames, between seconds; its logarithm is uniform."""
    return float(np.exp(rng.uniform(math.log(least), math.log(most))) * FRAME_RATE_HZ)


def load(rng: Generator, least: float, most: float) -> float:
    """Return a random load in counts; its logarithm is uniform."""
    return float(np.exp(rng.uniform(math.log(least), math.log(most))))


def presses(rng: Generator, frames: int, lasts: tuple[float, float], again: float) -> Floats:
    """Return the force (T,) of one press, or with probability `again` of several in a row."""
    force, begins = np.zeros(frames), 0.0
    for _ in range(rng.integers(2, 6) if rng.random() < again else 1):
        frames_down = seconds(rng, *lasts)
        rise, fall = (max(1.0, share * frames_down) for share in rng.uniform(0.1, 0.5, 2))
        force = np.maximum(
            force, rng.uniform(0.6, 1.0) * press(frames, begins, begins + frames_down, rise, fall)
        )
        begins += frames_down + seconds(rng, 0.1, 0.8)
    return force


def place(rng: Generator, spread: float = 1.6) -> tuple[float, float]:
    """Return a row and a column, mostly near the middle."""
    row, column = (3.5 + rng.normal(0.0, spread, 2)).clip(0.0, 7.0)
    return float(row), float(column)


def blow(rng: Generator, frames: int) -> Floats:
    """A fist or a flat hand strikes most of the pad, and is gone within 40 to 150 ms."""
    made, begins = np.zeros((frames, ROWS, COLUMNS)), 0
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        lasts = int(rng.integers(2, 8))
        force = rng.uniform(0.55, 1.0, lasts)
        force[0] *= rng.uniform(0.3, 1.0)
        force[-1] *= rng.uniform(0.2, 1.0)
        row, column = place(rng)
        width, length = rng.uniform(1.6, 6.0, 2)
        at = np.full(lasts, row), np.full(lasts, column)
        hit = spot(*at, width, length, rng.uniform(0.0, math.pi)) ** rng.uniform(0.4, 1.0)
        hit *= load(rng, 220.0, 1000.0) * force[:, None, None]
        stop = min(frames, begins + lasts)
        made[begins:stop] += hit[: stop - begins]
        begins = min(frames - 1, stop + int(seconds(rng, 0.25, 1.2)))
    return made


def squeeze(rng: Generator, frames: int) -> Floats:
    """Two parts of a hand close on the pad and hold it; sometimes several times."""
    lasts = seconds(rng, 0.5, 3.0)
    ticks = np.arange(frames)
    closing = (ticks / (lasts * rng.uniform(0.4, 1.0))).clip(0.0, 1.0) ** rng.uniform(0.6, 1.8)
    if rng.random() < 0.3:
        closing = 0.5 - 0.5 * np.cos(2.0 * math.pi * ticks * rng.uniform(0.6, 2.0) / FRAME_RATE_HZ)
        lasts = seconds(rng, 1.0, 8.0)
    row, column = place(rng, 0.8)
    angle = rng.uniform(0.0, math.pi)
    far, near = rng.uniform(1.6, 4.0), rng.uniform(0.3, 1.2)
    apart = far + (near - far) * closing
    force = press(frames, 0.0, lasts, rng.uniform(2.0, 12.0), rng.uniform(1.0, 10.0))
    force = force * (rng.uniform(0.15, 1.0) + rng.uniform(0.0, 1.0) * closing)
    force = force * (1.0 + 0.06 * smooth(rng, frames, 8.0))
    made = np.zeros((frames, ROWS, COLUMNS))
    for side, share in zip((-1.0, 1.0), rng.uniform(0.5, 1.0, 2), strict=True):
        at = row + side * apart * math.sin(angle), column + side * apart * math.cos(angle)
        made += share * spot(*at, rng.uniform(0.5, 1.3), rng.uniform(0.5, 2.2), angle)
    return made * (load(rng, 40.0, 800.0) * force)[:, None, None]


def pinch(rng: Generator, frames: int) -> Floats:
    """Two fingertips close on a fold of the pad, pull, and let go."""
    row, column = place(rng)
    angle = rng.uniform(0.0, math.pi)
    force = presses(rng, frames, (0.15, 2.0), 0.5)
    apart = rng.uniform(0.5, 0.9) + rng.uniform(0.0, 1.2) * (1.0 - force)
    drift = rng.uniform(0.0, 0.7) * smooth(rng, frames, 1.0)
    force = force * (1.0 + rng.uniform(0.0, 0.15) * smooth(rng, frames, 10.0))
    made = np.zeros((frames, ROWS, COLUMNS))
    for side, share in zip((-1.0, 1.0), rng.uniform(0.4, 1.0, 2), strict=True):
        at = row + side * apart * math.sin(angle) + drift, column + side * apart * math.cos(angle) + drift
        made += share * spot(*at, rng.uniform(0.4, 0.8), rng.uniform(0.4, 0.9), angle)
    return made * (load(rng, 40.0, 700.0) * force)[:, None, None]


def poke(rng: Generator, frames: int) -> Floats:
    """One fingertip pushes into the pad, once or at several places."""
    made, begins = np.zeros((frames, ROWS, COLUMNS)), 0.0
    row, column = place(rng)
    wide, peak = rng.uniform(0.4, 0.85), load(rng, 60.0, 900.0)
    for _ in range(rng.integers(1, 5)):
        lasts = seconds(rng, 0.1, 0.7)
        force = press(frames, begins, begins + lasts, rng.uniform(1.0, 6.0), rng.uniform(1.0, 6.0))
        at = np.full(frames, row), np.full(frames, column)
        made += peak * rng.uniform(0.5, 1.0) * force[:, None, None] * spot(*at, wide, wide)
        begins += lasts + seconds(rng, 0.15, 1.0)
        if rng.random() < 0.5:
            row, column = place(rng)
    return made


def twist(rng: Generator, frames: int) -> Floats:
    """A hand grips the pad and turns, to and fro."""
    row, column = place(rng, 0.8)
    turn = rng.uniform(0.0, math.pi) + rng.uniform(0.4, 1.5) * np.sin(
        2.0 * math.pi * rng.uniform(0.3, 1.6) * np.arange(frames) / FRAME_RATE_HZ
    )
    force = press(frames, 0.0, seconds(rng, 0.6, 8.0), rng.uniform(2.0, 15.0), rng.uniform(1.0, 12.0))
    force = force * (1.0 + 0.1 * smooth(rng, frames, 5.0))
    apart, made = rng.uniform(0.8, 2.2), np.zeros((frames, ROWS, COLUMNS))
    for side in (-1.0, 1.0):
        at = row + side * apart * np.sin(turn), column + side * apart * np.cos(turn)
        made += rng.uniform(0.5, 1.0) * spot(*at, rng.uniform(0.5, 1.1), rng.uniform(0.6, 1.6), turn)
    return made * (load(rng, 40.0, 500.0) * force)[:, None, None]


def knead(rng: Generator, frames: int) -> Floats:
    """The heels of two hands, or the fingers and the heel of one, sink in by turns."""
    row, column = place(rng, 0.8)
    angle, pace = rng.uniform(0.0, math.pi), rng.uniform(0.4, 1.8)
    swing = np.sin(2.0 * math.pi * pace * np.arange(frames) / FRAME_RATE_HZ + 0.6 * smooth(rng, frames, 0.6))
    force = press(frames, 0.0, seconds(rng, 1.0, 9.0), rng.uniform(2.0, 12.0), rng.uniform(1.0, 12.0))
    apart, made = rng.uniform(0.8, 2.4), np.zeros((frames, ROWS, COLUMNS))
    least = rng.uniform(0.0, 0.4)
    for side in (-1.0, 1.0):
        sunk = least + (1.0 - least) * (0.5 + 0.5 * side * swing)
        near = side * (apart - rng.uniform(0.0, 0.8) * sunk)
        at = row + near * math.sin(angle), column + near * math.cos(angle)
        made += sunk[:, None, None] * spot(*at, rng.uniform(0.8, 1.6), rng.uniform(0.8, 2.0), angle)
    return made * (load(rng, 40.0, 600.0) * force)[:, None, None]


def rolling(rng: Generator, frames: int) -> Floats:
    """A ball or a bottle rolls over the pad, slows down, and lies still or rocks, under a steady weight."""
    ticks = np.arange(frames) / FRAME_RATE_HZ
    angle = rng.uniform(0.0, 2.0 * math.pi)
    speed, slows = rng.uniform(2.0, 25.0), rng.uniform(0.2, 1.5)
    way = speed * slows * (1.0 - np.exp(-ticks / slows))
    if rng.random() < 0.5:
        way += rng.uniform(0.3, 1.2) * np.sin(2.0 * math.pi * rng.uniform(0.5, 2.0) * ticks) * np.exp(-ticks)
    row, column = place(rng, 0.8)
    begins = rng.uniform(1.0, 4.0)
    at = row + (way - begins) * math.sin(angle), column + (way - begins) * math.cos(angle)
    stays = rng.random() < 0.4
    if stays:
        at = at[0].clip(0.3, 6.7), at[1].clip(0.3, 6.7)
    body = spot(*at, rng.uniform(0.4, 1.2), rng.uniform(0.6, 4.0), angle)
    return body * load(rng, 25.0, 400.0)


def lies_down(rng: Generator, frames: int) -> Floats:
    """An object with straight edges is put or falls onto the pad, and lies there without a tremor."""
    half = rng.uniform(0.8, 3.5, 2)
    row, column = place(rng)
    inside = (np.abs(ROW - row) < half[0]) & (np.abs(COLUMN - column) < half[1])
    uneven = np.exp(rng.uniform(0.2, 0.8) * rng.normal(size=(ROWS, COLUMNS)))
    tips = 1.0 + rng.uniform(0.0, 1.0) * (ROW - row) / 4.0 + rng.uniform(0.0, 1.0) * (COLUMN - column) / 4.0
    ticks = np.arange(frames) / FRAME_RATE_HZ
    lands = rng.uniform(0.5, 3.0) * np.exp(-ticks / rng.uniform(0.02, 0.12))
    bounces = 1.0 + lands * np.abs(np.cos(2.0 * math.pi * rng.uniform(2.0, 8.0) * ticks))
    weight = load(rng, 15.0, 250.0) * bounces
    lain: Floats = (inside * uneven * tips.clip(0.05))[None] * weight[:, None, None]
    return lain


def elbow(rng: Generator, frames: int) -> Floats:
    """An elbow or a knuckle bears down on one place, and sways there."""
    row, column = place(rng)
    sways = [rng.uniform(0.05, 0.5) * smooth(rng, frames, rng.uniform(0.3, 1.5)) for _ in range(2)]
    force = press(frames, 0.0, seconds(rng, 0.8, 10.0), rng.uniform(6.0, 40.0), rng.uniform(3.0, 25.0))
    force = force * (1.0 + rng.uniform(0.05, 0.3) * smooth(rng, frames, rng.uniform(0.5, 3.0)))
    shape = spot(row + sways[0], column + sways[1], rng.uniform(0.6, 1.2), rng.uniform(0.7, 1.5))
    return shape * (load(rng, 250.0, 1000.0) * force)[:, None, None]


def sleeve(rng: Generator, frames: int) -> Floats:
    """Cloth is dragged over the pad: a wide, ragged front that sticks and slips, and flutters."""
    ticks = np.arange(frames) / FRAME_RATE_HZ
    angle = rng.uniform(0.0, 2.0 * math.pi)
    slips = np.cumsum(rng.random(frames) < 0.12) * rng.uniform(0.3, 1.2) + rng.uniform(0.5, 6.0) * ticks
    way = slips - rng.uniform(2.0, 5.0)
    row, column = place(rng, 0.8)
    at = row + way * math.sin(angle), column + way * math.cos(angle)
    front = spot(*at, rng.uniform(0.5, 1.2), rng.uniform(2.0, 5.0), angle)
    ragged = np.exp(rng.uniform(0.5, 1.0) * rng.normal(size=(ROWS, COLUMNS)))
    flutter: Floats = (1.0 + rng.uniform(0.3, 0.8) * rng.normal(size=(frames, ROWS, COLUMNS))).clip(0.0)
    force = press(frames, 0.0, seconds(rng, 0.5, 5.0), rng.uniform(1.0, 10.0), rng.uniform(1.0, 10.0))
    dragged: Floats = front * ragged * flutter * (load(rng, 6.0, 60.0) * force)[:, None, None]
    return dragged


MAKERS: Mapping[Maker, float] = MappingProxyType(
    {
        blow: 3.0,
        squeeze: 3.0,
        pinch: 2.0,
        poke: 2.0,
        twist: 1.5,
        knead: 1.5,
        rolling: 1.0,
        lies_down: 0.5,
        elbow: 0.7,
        sleeve: 0.5,
    }
)
"""How often each is made, relative to one another."""
SHARES = np.array([*MAKERS.values()]) / sum(MAKERS.values())


def make(rng: Generator, frames: int) -> Floats:
    """Return the counts above rest (T, 8, 8) of a touch by a random maker."""
    maker = [*MAKERS][rng.choice(len(SHARES), p=SHARES)]
    uneven = np.exp(UNEVEN * rng.normal(size=(ROWS, COLUMNS)))
    made: Floats = (maker(rng, frames) * uneven).clip(0.0, MAX_COUNT)
    return made


def on_rest(rng: Generator, rest: Recording) -> InPassing:
    """Return a simulated touch on a recording at rest, with rest before and after it."""
    before, frames = 10, WINDOW_FRAMES
    touch = make(rng, frames)
    over = min(frames, last_frame(touch))
    start = int(rng.integers(max(1, len(rest.counts) - before - frames - AFTER_FRAMES)))
    counts = rest.counts[start : start + before + over + AFTER_FRAMES].astype(np.float64)
    counts[before : before + over] += touch[:over]
    return InPassing(
        rest.participant,
        rest.substrate,
        rest.cover,
        OTHER,
        counts.clip(0, MAX_COUNT).astype(np.uint16),
        ideal_clock_ms(len(counts)),
        "live",
        first=before,
        over=before + over,
    )


def shuffled(rng: Generator, counts: Floats) -> Floats:
    """Return a recording (T, 8, 8) whose blocks of 3 to 10 frames are shuffled, turned and moved."""
    block = int(rng.integers(3, 11))
    blocks = [counts[start : start + block] for start in range(0, len(counts), block)]
    order = rng.permutation(len(blocks))
    turned = [np.rot90(blocks[place], int(rng.integers(4)), axes=(1, 2)) for place in order]
    moved = [np.roll(each, rng.integers(-2, 3, 2), axis=(1, 2)) for each in turned]
    mixed: Floats = np.concatenate(moved)
    return mixed


def last_frame(made: Floats) -> int:
    """Return the frame after the last one in which a simulated touch presses, at least 1."""
    pressed = np.flatnonzero(made.max(axis=(1, 2)) > 0.02 * made.max())
    return int(pressed[-1]) + 1 if len(pressed) else 1
