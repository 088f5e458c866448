"""Hands that follow pointers: they press a simulated pad as people press a real one."""

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pytest
from numpy.random import RandomState
from numpy.typing import NDArray
from rigs.haart_folder import BARE, needs_haart, recordings_of

from touchd.daemon.events import TouchEnded
from touchd.drivers.fakes.fabric import Fabric
from touchd.drivers.fakes.pointers import Pointer, PressingHands, Size
from touchd.drivers.frame import FRAME_RATE_HZ, Counts
from touchd.drivers.recording import Recording, read_recordings
from touchd.model.classifier import Classifier
from touchd.model.studies.play import frames_of, play

REST = round(FRAME_RATE_HZ)
NOISE_COUNTS = 3.0
LIGHTEST_LOAD = 12.0
SEEDS = 5

# Where a pointer is after a time in seconds, as shares of the pad; None when it is up.
Route: TypeAlias = Callable[[float], tuple[float, float] | None]


def stroke(time_s: float) -> tuple[float, float] | None:
    """Passes of 0.9 s, with as long between two as HAART's people take."""
    part = time_s % 1.4 / 0.9
    return (0.08 + 0.84 * part, 0.5) if part < 1.0 else None


def rub(time_s: float) -> tuple[float, float]:
    return 0.5 + 0.25 * math.sin(2 * math.pi * 1.4 * time_s), 0.5


def pat(time_s: float) -> tuple[float, float] | None:
    return (0.5, 0.5) if time_s % 0.3 < 0.1 else None


def constant(time_s: float) -> tuple[float, float]:
    return 0.5, 0.5


def one_pass(seconds: float, heading: float) -> Route:
    """A single pass over most of the pad, which begins and ends slowly."""

    def place(time_s: float) -> tuple[float, float] | None:
        part = time_s / seconds
        if part > 1.0:
            return None
        along = 0.7 * (0.5 * part + 0.25 * (1.0 - math.cos(math.pi * part)) - 0.5)
        return 0.5 + along * math.cos(heading), 0.5 + along * math.sin(heading)

    return place


def counts_under(route: Route, seed: int, size: Size = "hand", rest: int = REST) -> Counts:
    """Return frames of rest, a second unless told otherwise, and four seconds under a pointer."""
    rng = RandomState(seed)
    fabric, hands = Fabric(rng), PressingHands(rng)
    pressed = [hands.frame({}) for _ in range(rest)]
    for frame in range(round(4 * FRAME_RATE_HZ)):
        place = route(frame / FRAME_RATE_HZ)
        pointers = {} if place is None else {1: Pointer(8 * place[1] - 0.5, 8 * place[0] - 0.5, size)}
        pressed.append(hands.frame(pointers))
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
@pytest.mark.parametrize("route", [stroke, rub, pat, constant])
def test_a_pointers_hand_presses_as_peoples_do(haart: list[Recording], route: Route) -> None:
    gesture = route.__name__
    at_rest = {(r.participant, r.substrate): r.counts.mean(axis=0) for r in haart if r.gesture == "notouch"}
    real = [
        measures(r.counts, at_rest[r.participant, r.substrate])
        for r in haart
        if r.gesture == gesture and (r.participant, r.substrate) in at_rest
    ]
    made = [
        measures(counts[REST:], counts[:REST].mean(axis=0))
        for counts in (counts_under(route, seed) for seed in range(SEEDS))
    ]
    low, high = np.quantile(real, (0.1, 0.9), axis=0)
    median = np.median(made, axis=0)
    assert (low <= median).all(), (low, median)
    assert (median <= high).all(), (median, high)


def named(model: Classifier, counts: Counts) -> str:
    """Return what the daemon calls a touch in the end."""
    ended = [event for event in play(frames_of(counts), model, flush=True) if isinstance(event, TouchEnded)]
    return " ".join(event.gesture for event in ended)


@pytest.mark.parametrize("size", ["hand", "finger"])
@pytest.mark.parametrize("step", [3, pytest.param(1, marks=pytest.mark.slow)])
def test_a_single_slow_pass_is_named_stroke(classifier: Classifier, size: Size, step: int) -> None:
    routes = [one_pass(seconds, 0.4 * math.pi * turn) for seconds in (1.0, 2.0, 3.0) for turn in range(5)]
    routes = routes[::step]
    answers = [
        named(classifier, counts_under(route, seed, size, rest=3 * REST)) for seed, route in enumerate(routes)
    ]
    assert answers.count("stroke") >= 0.8 * len(answers), answers


def test_a_hand_that_comes_back_does_not_stroke(classifier: Classifier) -> None:
    answers = [named(classifier, counts_under(rub, seed, rest=3 * REST)) for seed in range(SEEDS)]
    assert answers.count("rub") >= SEEDS - 1, answers


def pressed_by(pointer: Pointer, frames: int) -> float:
    """Return the greatest pressure after some frames under a pointer."""
    hands = PressingHands(RandomState(1))
    return float([hands.frame({1: pointer}) for _ in range(frames)][-1].max())


def test_a_pens_pressure_counts() -> None:
    light, firm = (pressed_by(Pointer(3.5, 3.5, "finger", share), 54) for share in (0.2, 0.9))
    assert firm > 3 * light > 0


def test_a_mouse_presses_harder_where_it_stays() -> None:
    assert pressed_by(Pointer(3.5, 3.5, "hand"), 54) > 1.5 * pressed_by(Pointer(3.5, 3.5, "hand"), 8)


def test_two_fingers_press_in_two_places() -> None:
    hands = PressingHands(RandomState(1))
    places = {1: Pointer(1.0, 1.0, "finger"), 2: Pointer(6.0, 6.0, "finger")}
    for _ in range(20):
        pressed = hands.frame(places)
    assert pressed[1, 1] > 5
    assert pressed[6, 6] > 5
    assert pressed[1, 6] < 0.1


def test_a_hand_that_left_presses_no_more() -> None:
    hands = PressingHands(RandomState(1))
    hands.frame({1: Pointer(3.5, 3.5, "hand")})
    lifted = [hands.frame({}).max() for _ in range(40)]
    assert lifted[-1] == 0.0
