"""A session: one person's touches under one condition, one after another, as a pad in use would send them.

Each touch is followed by three seconds of that condition's notouch. A fabric's rest shifts when it is
touched. So after a pat, stroke or tickle, in which the hand leaves the pad, the notouch is shifted per taxel
to the lightest sixth of a second of that recording, until the next such touch.
"""

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, NO_TOUCH, ROWS, Counts
from touchd.drivers.recording import Recording, setup_of
from touchd.model.training.contacts import shift_of_rest

QUIET_FRAMES = 162
SKIPPED_FRAMES = 54
Scans = NDArray[np.uint16] | NDArray[np.float32]
Condition = tuple[str, str, str]
"""Person, substrate and cover."""
LIFTS_OFF = ("pat", "stroke", "tickle")


@dataclass(frozen=True, kw_only=True)
class SessionSettings:
    """How to make a session.

    seconds: length of each touch. rest_shifts: whether touches shift the rest, as above.
    The disturbances begin at disturbed_from_s: noise (standard deviation in counts, each taxel), hum (a 50 Hz
    sine on all taxels), motor (a sine of motor_hz, weighted by taxel), breathing (0.5 Hz, weighted by taxel);
    the last three are amplitudes in counts.
    """

    seconds: float = 6.0
    rest_shifts: bool = True
    noise: float = 0.0
    hum: float = 0.0
    motor: float = 0.0
    motor_hz: float = 23.0
    breathing: float = 0.0
    disturbed_from_s: float = 10.0


@dataclass(frozen=True, eq=False)
class Stretch:
    """Frames start <= i < stop of a session; gesture is None without a touch."""

    gesture: str | None
    start: int
    stop: int


@dataclass(frozen=True, eq=False)
class PlannedSession:
    """The pad's counts (T, 8, 8), and the true gesture of each stretch."""

    participant: str
    substrate: str
    cover: str
    counts: Counts
    stretches: tuple[Stretch, ...]


def sessions(recordings: Sequence[Recording], settings: SessionSettings) -> Iterator[PlannedSession]:
    """Yield a session for each person and condition with a notouch recording, from live recordings."""
    rng = random.Random(7)
    for key, by_gesture in together(recordings):
        yield _session(key, by_gesture, settings, rng)


def together(recordings: Sequence[Recording]) -> Iterator[tuple[Condition, dict[str, list[Scans]]]]:
    """Yield the counts by gesture of each person and condition with a notouch recording."""
    conditions: dict[Condition, dict[str, list[Scans]]] = {}
    for recording in recordings:
        by_gesture = conditions.setdefault(setup_of(recording), {})
        by_gesture.setdefault(recording.gesture, []).append(recording.counts)
    yield from ((key, counts) for key, counts in sorted(conditions.items()) if NO_TOUCH in counts)


def _session(
    key: Condition,
    by_gesture: dict[str, list[Scans]],
    settings: SessionSettings,
    rng: random.Random,
) -> PlannedSession:
    quiet = by_gesture[NO_TOUCH][0].astype(np.int64)
    quiet = quiet[SKIPPED_FRAMES:] if len(quiet) > 200 else quiet
    unshifted = quiet[60 : 60 + QUIET_FRAMES]
    frames = round(settings.seconds * FRAME_RATE_HZ)
    parts: list[tuple[str | None, NDArray[np.int64]]] = [(None, quiet[:QUIET_FRAMES])]
    still = unshifted
    gestures = sorted(set(by_gesture) - {NO_TOUCH})
    rng.shuffle(gestures)
    for gesture in gestures:
        for counts in by_gesture[gesture]:
            late = counts[SKIPPED_FRAMES : SKIPPED_FRAMES + frames].astype(np.int64)
            touch = late if len(late) == frames else counts[:frames].astype(np.int64)
            if settings.rest_shifts and gesture in LIFTS_OFF:
                still = _levelled(unshifted, touch)
            parts += [(gesture, touch), (None, still)]
    if len(quiet) > 400:
        parts.append((None, quiet[SKIPPED_FRAMES:]))
    stops = np.cumsum([len(counts) for _, counts in parts]).tolist()
    stretches = [
        Stretch(gesture, stop - len(counts), stop)
        for (gesture, counts), stop in zip(parts, stops, strict=True)
    ]
    clean = np.concatenate([counts for _, counts in parts])
    counts = np.clip(np.rint(clean + _disturbance(len(clean), settings)), 0, MAX_COUNT)
    return PlannedSession(*key, counts.astype(np.uint16), tuple(stretches))


def _levelled(still: NDArray[np.int64], touch: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the quiet frames shifted to the lightest sixth of a second of the touch, taxel by taxel."""
    levelled: NDArray[np.int64] = still + shift_of_rest(touch, still).astype(np.int64)
    return np.clip(levelled, 0, MAX_COUNT)


def _disturbance(frames: int, settings: SessionSettings) -> NDArray[np.float64]:
    """Return the counts (T, 8, 8) added by the disturbances."""
    rng = np.random.default_rng(0)
    at_s = (np.arange(frames) / FRAME_RATE_HZ)[:, None, None]
    weight = rng.uniform(0.5, 1.5, (ROWS, COLUMNS))
    added = settings.noise * rng.normal(size=(frames, ROWS, COLUMNS))
    added += settings.hum * np.sin(2 * np.pi * 50.0 * at_s)
    added += settings.motor * weight * np.sin(2 * np.pi * settings.motor_hz * at_s)
    added += settings.breathing * weight * np.sin(2 * np.pi * 0.5 * (at_s - settings.disturbed_from_s))
    added[: round(settings.disturbed_from_s * FRAME_RATE_HZ)] = 0.0
    return np.rint(added)
