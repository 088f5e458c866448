"""The doctor's checks of the pad itself: rest, noise, broken taxels, a press."""

from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from rigs.doctor_rig import SETTINGS, resting, sample

from touchd.daemon.doctor.values import (
    check_noise,
    check_press,
    check_quiet,
    check_rest,
    check_taxels,
    check_values,
)
from touchd.daemon.path.tracker import Sensitivity, TouchSettings
from touchd.drivers.frame import Counts
from touchd.drivers.pad.format import PRESETS
from touchd.drivers.search.search import as_yaml
from touchd.model.studies.simulated import simulate

TURN_OVER = f"set under sensor: {as_yaml(msgspec.structs.replace(PRESETS['fabric-grid'], invert=False))}"
Change = Callable[[Counts], object]


def changed(change: Change, seconds: float = 8.0) -> Counts:
    """Return the counts of a sound pad at rest after a change in place."""
    counts = resting(seconds)
    change(counts)
    return counts


def test_a_sound_pad_at_rest_has_only_living_taxels() -> None:
    sound = sample(resting())
    checks = [check_quiet(sound, SETTINGS), check_rest(sound, SETTINGS), check_noise(sound)]
    assert [check.verdict for check in [*checks, *check_taxels(sound)]] == ["ok"] * 4


@pytest.mark.parametrize(
    ("counts", "verdict", "found"),
    [
        (changed(lambda counts: counts[:, 3].fill(0)), "to do", "row 4"),
        (changed(lambda counts: counts[:, 2, 4].fill(7)), "to do", "row 3 column 5"),
        (np.zeros_like(resting()), "warning", "no value changed"),
        (resting(3.0), "not checked", "needs frames for 6.5 s"),
    ],
    ids=["a dead row", "a stuck taxel", "silent", "too few"],
)
def test_broken_taxels_are_named(counts: Counts, verdict: str, found: str) -> None:
    (check,) = check_taxels(sample(counts))
    assert check.verdict == verdict
    assert found in check.found


def noisy(counts: Counts, where: object) -> None:
    part = counts[where]  # type: ignore[index]
    part += np.random.default_rng(1).integers(0, 40, part.shape).astype(np.uint16)


def hum(counts: Counts) -> None:
    at_s = np.arange(len(counts)) / 54
    weights = np.random.default_rng(2).uniform(0.7, 1.3, (8, 8))
    counts += np.rint(6 + 5 * np.sin(2 * np.pi * 4.0 * at_s)[:, None, None] * weights).astype(np.uint16)


def loose_row(counts: Counts) -> None:
    counts[:, 2] += (6 * (np.arange(len(counts)) // 54 % 2))[:, None].astype(np.uint16)


def press(counts: Counts) -> None:
    counts[100:200, 2:6, 2:6] += 300


@pytest.mark.parametrize(
    ("disturb", "found"),
    [
        (hum, ": all taxels swing together by 5.0 counts, at 4 Hz as sampled: mains hum, or a motor"),
        (loose_row, ": the values of row 3 jump together"),
        (lambda counts: noisy(counts, np.s_[:, 6:7, 1:2]), ": row 7 column 2 is noisy"),
        (lambda counts: noisy(counts, np.s_[:]), ": the whole pad is noisy"),
        (press, " and 12 more is noisy"),
        (lambda counts: None, ""),
    ],
    ids=["hum", "a loose line", "a taxel", "all", "a press", "nothing"],
)
def test_the_cause_of_noise_is_named(disturb: Change, found: str) -> None:
    check = check_noise(sample(changed(disturb)))
    assert check.found.endswith(found)
    assert (check.verdict == "ok", check.advice == "") == (not found, not found)


@pytest.mark.parametrize(
    ("disturb", "clipped", "found"),
    [
        (lambda counts: counts[:, :, :3].fill(1023), 0.0, "a quarter of the pad or more is at its limit"),
        (press, 0.2, "values above full_scale 500 are cut to it"),
        (press, 0.0, ""),
    ],
    ids=["a short", "above full scale", "a press"],
)
def test_values_that_no_hand_makes_are_named(disturb: Change, clipped: float, found: str) -> None:
    seen = replace(sample(changed(disturb)), clipped=clipped)
    assert [check.found for check in check_values(seen, 500)] == ([found] if found else [])


HIGH = np.random.default_rng(1).uniform(60, 180, (8, 8)).astype(np.uint16)
LOADED = np.where(np.arange(64).reshape(8, 8) == 37, 600, HIGH).astype(np.uint16)


@pytest.mark.parametrize(
    ("counts", "verdict", "said"),
    [
        (np.uint16(1023) - resting(), "to do", TURN_OVER),
        (changed(lambda counts: counts[:, 1, 2].__iadd__(200)), "to do", "something lies on row 2 column 3"),
        (resting() + HIGH, "ok", "what a touch adds to that is recognised"),
        (resting() + LOADED, "to do", "something lies on row 5 column 6"),
    ],
    ids=["upside down", "a load", "a high rest", "a load on it"],
)
def test_a_load_is_distinguished_from_other_rest(counts: Counts, verdict: str, said: str) -> None:
    check = check_rest(sample(counts), SETTINGS)
    assert check.verdict == verdict
    assert said in f"{check.found} {check.advice}"


@pytest.mark.parametrize(("sensitivity", "advised"), [("normal", True), ("low", False)])
def test_a_touch_during_the_rest_check_is_reported(sensitivity: Sensitivity, advised: bool) -> None:
    script = (("notouch", 3.0), ("rub", 2.0), ("notouch", 2.0))
    counts = np.concatenate([recording.counts for recording in simulate(script, seed=3)])
    settings = msgspec.structs.replace(SETTINGS, touch=TouchSettings(sensitivity=sensitivity))
    check = check_quiet(sample(counts), settings)
    assert check.found == "touches detected while listening: 1"
    assert "loose wire" in check.advice
    assert ("touch.sensitivity" in check.advice) == advised


@pytest.mark.parametrize(
    ("counts", "verdict", "said"),
    [
        (300, "ok", "shows at row 1 column 8, counted from the top left"),
        (-300, "to do", TURN_OVER),
        (3, "not checked", "nothing was pressed"),
    ],
)
def test_a_press_shows_where_it_is_and_that_values_rise(counts: int, verdict: str, said: str) -> None:
    pressed = (resting(1.0) + 500).astype(np.int64)
    pressed[-10:, 0, 7] += counts
    check = check_press(sample(pressed.astype(np.uint16)), np.median(pressed, axis=0), SETTINGS)
    assert check.verdict == verdict
    assert said in f"{check.found} {check.advice}"
