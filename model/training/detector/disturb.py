"""Simulates other pads, and what disturbs a pad besides touches: one function for each, with its physics.

Every function takes (T, 8, 8) counts and a random generator, and returns counts. Pads are disturbed equally
with and without a hand, so a disturbance does not predict one.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS

Scans = NDArray[np.float32]
Rng = np.random.Generator
Disturbance = Callable[[Scans, Rng], Scans]


def read_by_another_pad(counts: Scans, rng: Rng) -> Scans:
    """Return counts as a pad of another gain, grid, material or rate would have read them."""
    for probability, change in OTHER_PADS:
        if rng.random() < probability:
            counts = change(counts, rng)
    return counts


def disturbed(counts: Scans, rng: Rng) -> Scans:
    """Return counts with some of the disturbances."""
    for probability, change in DISTURBANCES:
        if rng.random() < probability:
            counts = change(counts, rng)
    return counts


def _turned(counts: Scans, rng: Rng) -> Scans:
    """The pad is mounted another way round."""
    counts = np.rot90(counts, int(rng.integers(4)), axes=(1, 2))
    return _as_scans(counts[:, ::-1] if rng.random() < 0.5 else counts)


def _gained(counts: Scans, rng: Rng) -> Scans:
    """Another gain of amplifier and hand: mostly within a factor of two, sometimes within a factor of ten."""
    spread = 0.35 if rng.random() < 0.8 else 1.1
    gain = np.exp(np.clip(spread * rng.normal(), -2.3, 1.8))
    return _as_scans(counts * gain * np.exp(0.1 * rng.normal(size=(ROWS, COLUMNS))))


def _coarser(counts: Scans, rng: Rng) -> Scans:
    """A pad of fewer cells, interpolated to 8x8."""
    side = int(rng.integers(3, ROWS))
    weights = _overlap(side)
    cells = np.einsum("iy,tyx,jx->tij", weights, counts, weights, optimize=True)
    back = _linear(side)
    return _as_scans(np.einsum("yi,tij,xj->tyx", back, cells, back, optimize=True))


def _overlap(side: int) -> Scans:
    """Return (side, 8): how much of each taxel lies in each cell of a coarser pad, as shares of the cell."""
    edges = np.linspace(0, ROWS, side + 1)
    taxels = np.arange(ROWS)
    shared = np.minimum(edges[1:, None], taxels + 1) - np.maximum(edges[:-1, None], taxels)
    weights = np.maximum(shared, 0.0)
    return _as_scans(weights / weights.sum(axis=1, keepdims=True))


def _linear(side: int) -> Scans:
    """Return (8, side): linear interpolation from cells to taxels."""
    at = np.clip((np.arange(ROWS) + 0.5) * side / ROWS - 0.5, 0, side - 1)
    return _as_scans(np.maximum(1.0 - np.abs(at[:, None] - np.arange(side)), 0.0))


def _softer(counts: Scans, rng: Rng) -> Scans:
    """Silicone creeps: each taxel follows with one time constant up, and a longer one down."""
    rise_s, fall_s = 0.15 * rng.random() ** 2, 1.2 * rng.random() ** 2
    rise, fall = (1.0 - np.exp(-1.0 / (FRAME_RATE_HZ * each + 1e-3)) for each in (rise_s, fall_s))
    followed = np.empty_like(counts)
    now = counts[0]
    for i, scan in enumerate(counts):
        change = scan - now
        now = now + np.where(change > 0, rise, fall).astype(np.float32) * change
        followed[i] = now
    return followed


def _slower(counts: Scans, rng: Rng) -> Scans:
    """A pad that sends fewer frames, laid on the 54 Hz grid by linear interpolation."""
    step = FRAME_RATE_HZ / np.exp(rng.uniform(np.log(8.0), np.log(50.0)))
    at = np.arange(len(counts)) / step
    low = np.rint(np.floor(at) * step).astype(int).clip(0, len(counts) - 1)
    high = np.rint(np.ceil(at) * step).astype(int).clip(0, len(counts) - 1)
    share = (at - np.floor(at)).astype(np.float32)[:, None, None]
    return _as_scans(counts[low] + share * (counts[high] - counts[low]))


def _noise(counts: Scans, rng: Rng) -> Scans:
    """Converter noise, of a different level in each taxel, from some time on."""
    deviation = rng.uniform(0.0, 2.2) * np.exp(0.4 * rng.normal(size=(ROWS, COLUMNS)))
    return _as_scans(counts + _from_some_time(rng, len(counts)) * deviation * rng.normal(size=counts.shape))


def _tone(low_hz: float, high_hz: float, most_counts: float, *, is_common: bool) -> Disturbance:
    """Mains hum (4 Hz once sampled), a motor, a body that breathes: a sine, with or without taxel weights."""

    def added(counts: Scans, rng: Rng) -> Scans:
        at_s = np.arange(len(counts))[:, None, None] / FRAME_RATE_HZ
        hz, depth = np.exp(rng.uniform(np.log(low_hz), np.log(high_hz))), most_counts * rng.random()
        weights: Scans = np.ones((ROWS, COLUMNS), np.float32)
        if not is_common and rng.random() < 0.5:
            weights = _as_scans(rng.uniform(0.3, 1.7, (ROWS, COLUMNS)))
        elif not is_common:
            weights = _as_scans(1.0 + 0.7 * _field(rng))
        tone = depth * np.sin(2 * np.pi * (hz * at_s + rng.random()))
        return _as_scans(counts + _from_some_time(rng, len(counts)) * weights * tone)

    return added


def _drift(counts: Scans, rng: Rng) -> Scans:
    """Temperature and supply: rest drifts by up to a count a second, varying over the pad."""
    at_s = np.arange(len(counts))[:, None, None] / FRAME_RATE_HZ
    return _as_scans(counts + rng.uniform(-1.0, 1.0) * at_s * (0.5 + 0.5 * np.abs(_field(rng))))


def _step(counts: Scans, rng: Rng) -> Scans:
    """The supply changes: all taxels step by the same, or by some counts each."""
    after = np.arange(len(counts))[:, None, None] >= rng.integers(60, len(counts))
    height = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(0.0, np.log(60.0)))
    return _as_scans(counts + after * height * (1.0 + 0.15 * rng.normal(size=(ROWS, COLUMNS))))


def _loose_wire(counts: Scans, rng: Rng) -> Scans:
    """A connector flexes: the taxels of one row or column jump together, and back."""
    height = np.exp(rng.uniform(np.log(1.5), np.log(30.0)))
    interval = int(rng.integers(15, 160))
    edges = np.cumsum(rng.integers(max(2, interval // 3), interval * 2, 2 * len(counts) // interval + 4))
    is_up = (np.searchsorted(edges, np.arange(len(counts))) % 2).astype(bool)
    line = np.zeros((ROWS, COLUMNS))
    line[int(rng.integers(ROWS))] = height * (1.0 + 0.25 * rng.normal(size=COLUMNS))
    return _as_scans(counts + is_up[:, None, None] * (line if rng.random() < 0.5 else line.T))


def _footsteps(counts: Scans, rng: Rng) -> Scans:
    """A robot walks: its body shakes the whole pad for a tenth of a second, twice a second."""
    at_s = np.arange(len(counts)) / FRAME_RATE_HZ
    phase = (at_s * rng.uniform(0.7, 2.5) + rng.random()) % 1.0
    width = rng.uniform(0.08, 0.25)
    bump = np.where(phase < width, np.sin(np.pi * phase / width), 0.0)[:, None, None]
    return _as_scans(counts + rng.uniform(2.0, 9.0) * bump * (1.0 + 0.35 * _field(rng)))


def _spikes(counts: Scans, rng: Rng) -> Scans:
    """A damaged frame now and then: one taxel reads anything."""
    spiked = counts.copy()
    for at in rng.integers(0, len(counts), int(rng.integers(1, 6))):
        spiked[at, rng.integers(ROWS), rng.integers(COLUMNS)] = rng.uniform(0, 1023)
    return _as_scans(spiked)


def _high_rest(counts: Scans, rng: Rng) -> Scans:
    """A pad that rests far from 0, at a different level in each taxel."""
    return _as_scans(counts + rng.uniform(0, 200) * rng.uniform(0.3, 1.7, (ROWS, COLUMNS)))


def _dead_taxels(counts: Scans, rng: Rng) -> Scans:
    """A row, or single taxels, that read nothing."""
    alive = rng.random((ROWS, COLUMNS)) > 0.03
    if rng.random() < 0.5:
        alive[int(rng.integers(ROWS))] = False
    return _as_scans(counts * alive)


def _load(counts: Scans, rng: Rng) -> Scans:
    """An object has lain on the pad from the start: it adds noise, and may be removed."""
    field = np.maximum(_field(rng), 0.0) * np.exp(rng.uniform(np.log(10.0), np.log(300.0)))
    is_there = np.ones(len(counts))
    if rng.random() < 0.4:
        is_there[int(rng.integers(60, len(counts))) :] = 0.0
    noise = 1.0 + 0.01 * rng.normal(size=len(counts))
    return _as_scans(counts + (is_there * noise)[:, None, None] * field)


OTHER_PADS: tuple[tuple[float, Disturbance], ...] = (
    (0.9, _turned),
    (1.0, _gained),
    (0.2, _coarser),
    (0.15, _softer),
    (0.2, _slower),
)
DISTURBANCES: tuple[tuple[float, Disturbance], ...] = (
    (0.10, _load),
    (0.15, _high_rest),
    (0.50, _noise),
    (0.15, _tone(3.0, 26.0, 3.0, is_common=True)),
    (0.15, _tone(3.0, 26.0, 3.0, is_common=False)),
    (0.25, _tone(0.2, 1.0, 3.5, is_common=False)),
    (0.30, _drift),
    (0.08, _step),
    (0.20, _loose_wire),
    (0.08, _footsteps),
    (0.06, _spikes),
    (0.08, _dead_taxels),
)
"""Each with the share of pieces to which it happens."""


def _from_some_time(rng: Rng, frames: int) -> Scans:
    """Return (T, 1, 1), 0 before a time and 1 after; mostly 1 from the start."""
    since = 0 if rng.random() < 0.5 else int(rng.integers(frames))
    return _as_scans((np.arange(frames) >= since)[:, None, None].astype(np.float32))


def _field(rng: Rng) -> Scans:
    """Return a random field (8, 8), about standard normal, that varies smoothly over the pad."""
    field: Scans = zoom(rng.normal(size=(3, 3)), (ROWS / 3, COLUMNS / 3), order=2).astype(np.float32)
    return field


def _as_scans(counts: object) -> Scans:
    return np.asarray(counts, np.float32)
