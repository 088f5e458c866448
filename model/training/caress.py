"""Simulates slow caresses for training: recorded strokes last up to 1 s, but people also stroke for 8 s."""

import math

import numpy as np
from numpy.random import Generator

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, ROWS
from touchd.model.training.unknown import Floats, load, smooth, spot

SLOWEST = 0.25
MOST_FRAMES = round(8 * FRAME_RATE_HZ)
# Palm and fingers: the place along and across the hand, and the radius, in taxels; the share of the force.
HAND = ((-1.2, 0.0, 2.0, 0.7), (1.2, -1.3, 1.0, 0.6), (1.2, -0.4, 1.0, 0.6), (1.2, 0.5, 1.0, 0.6))


def slowed(rng: Generator, stroke: Floats) -> Floats:
    """Return a recorded stroke (T, 8, 8) at 0.25 to 1 of its speed, whose hand sways and presses unevenly."""
    slower = math.exp(rng.uniform(math.log(SLOWEST), 0.0))
    frames = min(MOST_FRAMES, round(len(stroke) / slower))
    # Its speed varies too.
    pace = np.exp(0.25 * smooth(rng, frames, 1.0))
    places = np.cumsum(pace) - pace[0]
    places *= (len(stroke) - 1) / max(1.0, places[-1])
    below = np.minimum(places.astype(int), len(stroke) - 2)
    part = (places - below)[:, None, None]
    laid = (1.0 - part) * stroke[below] + part * stroke[below + 1]
    return _swayed(rng, laid) * np.exp(0.12 * smooth(rng, frames, 3.0))[:, None, None]


def made(rng: Generator) -> Floats:
    """Return the counts (T, 8, 8) above rest of a simulated hand that strokes the pad once in 0.8 to 8 s."""
    frames = round(FRAME_RATE_HZ * math.exp(rng.uniform(math.log(0.8), math.log(8.0))))
    angle = rng.uniform(0.0, 2.0 * math.pi)
    pace = np.exp(0.3 * smooth(rng, frames, 1.0))
    part = np.cumsum(pace) / pace.sum() - 0.5
    way = rng.uniform(4.0, 9.0) * part
    across = rng.uniform(0.05, 0.4) * smooth(rng, frames, 1.0)
    row, column = 3.5 + rng.normal(0.0, 0.8, 2)
    heading = angle + rng.uniform(-0.4, 0.4)
    parts = HAND if rng.random() < 0.7 else HAND[1:]
    size, total = rng.uniform(0.7, 1.2), np.zeros((frames, ROWS, COLUMNS))
    for along, beside, radius, share in parts:
        down = along * math.sin(heading) + beside * math.cos(heading) + way * math.sin(angle)
        over = along * math.cos(heading) - beside * math.sin(heading) + way * math.cos(angle)
        at = row + down + across * math.cos(angle), column + over - across * math.sin(angle)
        slips = np.exp(0.25 * smooth(rng, frames, 9.0)) * rng.uniform(0.5, 1.5) * share
        total += slips[:, None, None] * spot(*at, size * radius, size * radius)
    edge = np.minimum(np.arange(frames) + 1, frames - np.arange(frames)) / rng.uniform(3.0, 12.0)
    force = edge.clip(0.0, 1.0) * np.exp(rng.uniform(0.05, 0.25) * smooth(rng, frames, 2.0))
    caress: Floats = (total * (load(rng, 4.0, 80.0) * force)[:, None, None]).clip(0.0, MAX_COUNT)
    return caress


def _swayed(rng: Generator, counts: Floats) -> Floats:
    """Return counts that move to and fro by up to half a taxel, like a hand that sways."""
    for axis in (1, 2):
        sway = rng.uniform(0.0, 0.3) * smooth(rng, len(counts), 0.8)[:, None, None]
        share = np.abs(sway).clip(0.0, 0.6)
        ahead, behind = np.roll(counts, -1, axis), np.roll(counts, 1, axis)
        edge = [slice(None)] * 3
        edge[axis] = slice(-1, None)
        ahead[tuple(edge)] = counts[tuple(edge)]
        edge[axis] = slice(0, 1)
        behind[tuple(edge)] = counts[tuple(edge)]
        counts = (1.0 - share) * counts + share * np.where(sway > 0, ahead, behind)
    return counts
