"""Simulated recordings of the seven gestures: the demo's, and those of tests and studies.

A hand is a few round patches of pressure, each with a path and a force over time. The pad adds what HAART's
recordings show: a rest level for each row and taxel, noise, taxels of unequal sensitivity, and a leak along
the rows. Forces, sizes and paces are set to match load, peak, area, pace and speed of each gesture in HAART's
training recordings on the bare pad; no network's answers were used.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from touchd.drivers.fakes.hand import Fabric
from touchd.drivers.fakes.pointers import Part, fingers
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS
from touchd.drivers.recording import Recording, ideal_clock_ms, write_recordings

Series = NDArray[np.float64]

EDGE_S = 0.08

DEMO_SEED = 3
DEMO_SCRIPT = (
    ("notouch", 2.5),
    *(
        step
        for gesture in ("pat", "stroke", "rub", "scratch", "tickle", "constant")
        for step in ((gesture, 3.8), ("notouch", 1.8))
    ),
)


@dataclass(frozen=True, eq=False)
class Patch:
    """One round area of contact over T frames, in the hand's own directions.

    along, across: (T,) centre in taxels relative to the hand's place, along the fingers and across them.
    radius: standard deviation in taxels. force: (T,) counts at the centre.
    """

    along: Series
    across: Series
    radius: float
    force: Series


def wander(rng: RandomState, time_s: Series, fastest_hz: float) -> Series:
    """Return smooth noise (T,) of unit deviation with nothing faster than `fastest_hz`."""
    waves = 6
    hz = fastest_hz * rng.uniform(0.2, 1.0, waves)
    phases = rng.uniform(0.0, 2.0 * np.pi, waves)
    noise: Series = np.sqrt(2.0 / waves) * np.sin(2.0 * np.pi * np.outer(time_s, hz) + phases).sum(axis=1)
    return noise


def cycles(rng: RandomState, time_s: Series, pace_hz: float) -> Series:
    """Return the number of movements up to each time (T,), at a person's own and slightly uneven pace."""
    pace = pace_hz * rng.lognormal(0.0, 0.1) * (1.0 + 0.06 * wander(rng, time_s, 0.8))
    return np.cumsum(pace) / FRAME_RATE_HZ


# Palm and four fingers.
FLAT_HAND = (Part(-1.2, 0.0, 2.2, 0.7), *(Part(1.2, place, 1.1, 0.6) for place in fingers(4)))


def flat_hand(
    rng: RandomState, time_s: Series, along: Series, across: Series, force: Series, friction: float
) -> list[Patch]:
    """Return palm and four fingers that share `force`; each grips and slips on its own."""
    parts = [
        Patch(along + part.along, across + part.across, part.radius, part.share * force) for part in FLAT_HAND
    ]
    return [
        replace(
            part,
            along=part.along + rng.normal(0.0, 0.2),
            force=rng.uniform(0.5, 1.5) * part.force * (1.0 + friction * wander(rng, time_s, 12.0)),
        )
        for part in parts
    ]


def constant(rng: RandomState, time_s: Series) -> list[Patch]:
    """A flat hand that lies still, with a slow drift and a little tremor."""
    still = np.zeros_like(time_s)
    return flat_hand(rng, time_s, still, still, 30.0 * (1.0 + 0.05 * wander(rng, time_s, 0.5)), 0.015)


def pat(rng: RandomState, time_s: Series) -> list[Patch]:
    """A flat hand that taps at 3 to 4 Hz, down for a tenth of a second, and lifts off in between."""
    tap = np.maximum(0.0, np.sin(2.0 * np.pi * cycles(rng, time_s, 3.5)) - 0.3) / 0.7
    force = 11.0 * tap * (1.0 + 0.3 * wander(rng, time_s, 1.5))
    along, across = (0.4 * wander(rng, time_s, 1.7) for _ in range(2))
    return flat_hand(rng, time_s, along, across, force, 0.15)


def stroke(rng: RandomState, time_s: Series) -> list[Patch]:
    """A flat hand drawn over the pad one way, lifted and brought back, about once a second."""
    part = np.minimum(1.0, cycles(rng, time_s, 1.0) % 1.0 / 0.65)
    force = 7.0 * np.sin(np.pi * part) ** 0.8 * (part < 1.0)
    across = 0.2 * wander(rng, time_s, 1.0)
    return flat_hand(rng, time_s, 5.0 * (part - 0.5), across, force, 0.5)


def rub(rng: RandomState, time_s: Series) -> list[Patch]:
    """A flat hand that moves to and fro on the pad and presses more one way than the other."""
    swing = 2.0 * np.pi * cycles(rng, time_s, 1.4)
    force = 12.0 * (0.8 + 0.2 * np.sin(swing)) * (1.0 + 0.15 * wander(rng, time_s, 6.0))
    across = 0.4 * wander(rng, time_s, 1.0)
    return flat_hand(rng, time_s, 2.4 * np.cos(swing), across, force, 0.15)


def scratch(rng: RandomState, time_s: Series) -> list[Patch]:
    """Fingertips side by side that dig in and pull together, at about 3 Hz."""
    pull = 2.0 * np.pi * cycles(rng, time_s, 3.1)
    along = 0.6 * np.cos(pull) + 0.5 * wander(rng, time_s, 0.7)
    force = (0.3 + 0.7 * np.maximum(0.0, np.sin(pull))) * (1.0 + 0.25 * wander(rng, time_s, 6.0))
    tips = [
        Patch(along + rng.normal(0.0, 0.3), place + 0.0 * along, 0.5, rng.uniform(20.0, 150.0) * force)
        for place in fingers(3)
    ]
    return [*tips, Patch(along - 1.0, 0.0 * along, 1.8, 5.0 * force)]


def tickle(rng: RandomState, time_s: Series) -> list[Patch]:
    """Fingertips that flutter lightly, out of step, and wander over the pad."""
    along, across = (0.5 * wander(rng, time_s, 1.0) for _ in range(2))
    tips: list[Patch] = []
    for place in fingers(4):
        flutter = 2.0 * np.pi * cycles(rng, time_s, 3.8)
        force = np.maximum(
            0.0, np.sin(flutter + rng.uniform(-3.0, 3.0)) + 0.9 * wander(rng, time_s, 14.0) - 0.6
        )
        tips.append(Patch(along + 0.4 * np.cos(flutter), across + 1.2 * place, 0.5, 24.0 * force))
    return [*tips, Patch(along, across, 2.0, 2.0 * (1.0 + 0.5 * wander(rng, time_s, 10.0)))]


def notouch(rng: RandomState, time_s: Series) -> list[Patch]:
    """Nothing on the pad."""
    return []


GESTURES: Mapping[str, Callable[[RandomState, Series], list[Patch]]] = {
    gesture.__name__: gesture for gesture in (constant, notouch, pat, rub, scratch, stroke, tickle)
}


def pressure(gesture: str, frames: int, rng: RandomState, cells: tuple[int, int] = (ROWS, COLUMNS)) -> Series:
    """Return (frames, rows, columns) counts of pressure: from rest, through the gesture, to a release.

    cells: rows and columns of a pad of the usual size. Places and sizes are in taxels of the 8x8 pad.
    """
    time_s = np.arange(frames) / FRAME_RATE_HZ
    # Soft hand on soft pad: force grows with the square of the depth.
    edge = (np.minimum(time_s, time_s[::-1]) / EDGE_S).clip(max=1.0) ** 2
    strength = edge * rng.lognormal(0.0, 0.25)
    heading = rng.uniform(0.0, 2.0 * np.pi)
    row, column = 3.5 + rng.normal(0.0, 0.5, 2)
    rows, columns = (
        (np.arange(n) + 0.5) * side / n - 0.5 for n, side in zip(cells, (ROWS, COLUMNS), strict=True)
    )
    total = np.zeros((frames, *cells))
    for patch in GESTURES[gesture](rng, time_s):
        centre_row = row + patch.along * np.sin(heading) + patch.across * np.cos(heading)
        centre_column = column + patch.along * np.cos(heading) - patch.across * np.sin(heading)
        down = np.exp(-0.5 * ((rows - centre_row[:, None]) / patch.radius) ** 2)
        over = np.exp(-0.5 * ((columns - centre_column[:, None]) / patch.radius) ** 2)
        total += (strength * patch.force)[:, None, None].clip(0.0) * down[:, :, None] * over[:, None, :]
    return total


def simulate(script: Sequence[tuple[str, float]], seed: int) -> list[Recording]:
    """Return a pad's counts at 54 Hz during a script of (gesture, seconds), a recording each.

    Each touch has its own strength, place, direction and pace, as people's have. The clock continues from one
    recording to the next. The same script and seed give the same counts on every machine.
    """
    # numpy guarantees RandomState's numbers across versions, but not a Generator's.
    rng = RandomState(seed)
    pressed = [pressure(gesture, round(seconds * FRAME_RATE_HZ), rng) for gesture, seconds in script]
    counts = Fabric(rng).read(np.concatenate(pressed))
    stops = np.cumsum([len(part) for part in pressed])
    clock_ms = ideal_clock_ms(len(counts))
    return [
        Recording("simulated", "none", "none", gesture, part, part_ms, "live")
        for (gesture, _), part, part_ms in zip(
            script, np.split(counts, stops[:-1]), np.split(clock_ms, stops[:-1]), strict=True
        )
    ]


def write_simulated(path: Path, script: Sequence[tuple[str, float]], seed: int) -> None:
    """Write what `simulate` returns to a new .csv or .csv.gz file, with its provenance.

    Raises RecordingError when the file is there already or cannot be written.
    """
    provenance = {
        "source": "SIMULATED; no person's data",
        "sensor": f"none; a simulated pad of {ROWS}x{COLUMNS} taxels at {FRAME_RATE_HZ:g} Hz",
        "seed": str(seed),
        "licence": "Apache-2.0",
    }
    write_recordings(path, simulate(script, seed), provenance)
