"""Hands that follow pointers: they press a simulated pad as people press a real one."""

import numpy as np
import pytest
from numpy.random import RandomState
from numpy.typing import NDArray
from rigs.haart_folder import BARE, needs_haart, recordings_of
from rigs.visitors import KINDS, counts_of, named

from touchd.drivers.fakes.hand import PLAYED, Fabric
from touchd.drivers.fakes.pointers import Pointer, PressingHands
from touchd.drivers.frame import FRAME_RATE_HZ, Counts
from touchd.drivers.recording import Recording, read_recordings
from touchd.model.classifier import Classifier

REST = round(FRAME_RATE_HZ)
NOISE_COUNTS = 3.0
LIGHTEST_LOAD = 12.0
SEEDS = 5


def counts_under(gesture: str, seed: int) -> Counts:
    """Return a second of rest and four seconds of a gesture of the simulated hand."""
    rng = RandomState(seed)
    fabric, hands = Fabric(rng), PressingHands(rng)
    size, make = PLAYED[gesture]
    path = make(rng)
    pressed = [hands.frame({}) for _ in range(REST)]
    for frame in range(round(4 * FRAME_RATE_HZ)):
        place = path(frame / FRAME_RATE_HZ)
        pressed.append(hands.frame({} if place is None else {1: Pointer(*place, size)}))
    return fabric.read(np.array(pressed))


def measures(counts: Counts, rest: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return load, peak and area of a touch, medians over its frames in contact."""
    rise = np.maximum(counts - rest - NOISE_COUNTS, 0.0)
    load = rise.sum(axis=(1, 2))
    touched = rise[load > LIGHTEST_LOAD]
    return (
        float(np.median(touched.sum(axis=(1, 2)))),
        float(np.median(touched.max(axis=(1, 2)))),
        float(np.median((touched > 2.0).sum(axis=(1, 2)))),
    )


@pytest.fixture(scope="module")
def haart(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    return read_recordings(recordings_of("training.csv", BARE, tmp_path_factory.mktemp("haart")))


@needs_haart
@pytest.mark.parametrize("gesture", PLAYED)
def test_the_simulated_hand_presses_as_peoples_do(haart: list[Recording], gesture: str) -> None:
    at_rest = {(r.participant, r.substrate): r.counts.mean(axis=0) for r in haart if r.gesture == "notouch"}
    real = [
        measures(r.counts, at_rest[r.participant, r.substrate])
        for r in haart
        if r.gesture == gesture and (r.participant, r.substrate) in at_rest
    ]
    made = [
        measures(counts[REST:], counts[:REST].mean(axis=0))
        for counts in (counts_under(gesture, seed) for seed in range(SEEDS))
    ]
    low, high = np.quantile(real, (0.1, 0.9), axis=0)
    median = np.median(made, axis=0)
    assert (low <= median).all(), (low, median)
    assert (median <= high).all(), (median, high)


def loads_under(seconds: float, *, moves: bool) -> NDArray[np.float64]:
    """Return the load in each frame, in counts, of a pointer that is down for some time."""
    hands = PressingHands(RandomState(4))
    loads = []
    for frame in range(round((seconds + 0.5) * FRAME_RATE_HZ)):
        column = 1.0 + 5.0 * moves * frame / FRAME_RATE_HZ / seconds
        is_down = frame < seconds * FRAME_RATE_HZ
        loads.append(hands.frame({1: Pointer(3.5, column, "hand")} if is_down else {}).sum())
    return np.array(loads)


@pytest.mark.parametrize("click_s", [0.03, 0.1, 0.2])
def test_a_click_strikes_as_a_pat_does(click_s: float) -> None:
    """However long the button is down, the hand is off after four to seven frames, as in recorded pats."""
    loads = loads_under(click_s, moves=False)
    touched = np.flatnonzero(loads > LIGHTEST_LOAD)
    assert 120 < loads.max() < 440
    assert loads.argmax() - touched[0] <= 2
    assert loads[touched[0] + 6 :].max() < 0.25 * loads.max()


# Those that the network is sure of; docs/live.md has the figures of all.
@pytest.mark.parametrize("name", ["three pats", "still hand", "fingertips, scratching for 2 s"])
def test_gestures_made_with_the_pointer_are_recognised(classifier: Classifier, name: str) -> None:
    (kind,) = (kind for kind in KINDS if kind.name == name)
    names = [named(classifier, counts_of(kind, seed)) for seed in range(SEEDS)]
    assert names.count(kind.gesture) >= SEEDS - 1, names
