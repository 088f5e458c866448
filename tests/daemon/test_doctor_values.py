"""The doctor's checks of the pad itself: rest, noise, broken taxels, orientation."""

from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from rigs.doctor_rig import SETTINGS, pad_of, resting, sample

from touchd.daemon.doctor.check import listen
from touchd.daemon.doctor.values import (
    check_noise,
    check_orientation,
    check_quiet,
    check_rest,
    check_taxels,
    check_values,
    is_pressed,
)
from touchd.daemon.path.tracker import Sensitivity, TouchSettings
from touchd.drivers.frame import Counts
from touchd.drivers.pad.format import PRESETS
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import open_port
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
        (lambda counts: noisy(counts, np.s_[:, 6:7, 1:2]), ": noise at row 7 column 2"),
        (lambda counts: noisy(counts, np.s_[:]), ": the whole pad is noisy"),
        (press, " and 12 more"),
        (lambda counts: None, ""),
    ],
    ids=["hum", "a loose line", "a taxel", "all", "a press", "nothing"],
)
def test_the_cause_of_noise_is_named(disturb: Change, found: str) -> None:
    check = check_noise(sample(changed(disturb)))
    assert check.found.endswith(found)
    assert (check.verdict == "ok", check.advice == "") == (not found, not found)


SATURATED = "at its limit: take the load off the pad; if there is none, check format's invert"


def jumping(counts: Counts) -> None:
    counts[1::2, 2:4, 2:4] += np.uint16(300)


@pytest.mark.parametrize(
    ("disturb", "clipped", "found"),
    [
        (lambda counts: counts[:, :, :3].fill(1023), 0.0, SATURATED),
        (lambda counts: np.subtract(1023, counts, out=counts), 0.0, SATURATED),
        (jumping, 0.0, "values jump from frame to frame, as no hand makes them"),
        (press, 0.2, "values above full_scale 500 are cut to it"),
        (press, 0.0, ""),
    ],
    ids=["a short", "upside down", "jumps", "above full scale", "a press"],
)
def test_values_that_no_hand_makes_are_named(disturb: Change, clipped: float, found: str) -> None:
    seen = replace(sample(changed(disturb)), clipped=clipped)
    said = [f"{check.found}: {check.advice}" for check in check_values(seen, 500)]
    assert len(said) == bool(found)
    assert found in "".join(said)


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
    ("row", "column", "counts", "verdict", "said"),
    [
        (0, 1, 300, "ok", ""),
        (7, 7, 300, "to do", "add 180"),
        (0, 7, 300, "to do", "add 270"),
        (7, 0, 300, "to do", "add 90"),
        (3, 5, 300, "not checked", "pressed elsewhere, at row 4 column 6"),
        (0, 0, 3, "not checked", "no corner was pressed"),
        (0, 0, -300, "to do", TURN_OVER),
    ],
)
def test_the_pressed_corner_shows_how_the_pad_is_mounted(
    row: int, column: int, counts: int, verdict: str, said: str
) -> None:
    pressed = resting(1.0).astype(np.int64) + 500
    pressed[-10:, row, column] += counts
    check = check_orientation(sample(pressed.astype(np.uint16)), np.median(pressed, axis=0), SETTINGS)
    assert check.verdict == verdict
    assert said in f"{check.found} {check.advice}"


def test_listening_ends_when_the_corner_is_pressed() -> None:
    counts = resting(20.0)
    counts[100:, 0, 0] += 300
    rest = np.median(counts[:100], axis=0)
    with pad_of(counts, speed=4.0) as port, open_port(port.path, 512_000) as opened:
        parser = FrameParser(SETTINGS.sensor.described)
        found = listen(opened, parser, 15.0, enough=lambda frame: is_pressed(frame, rest))
    assert check_orientation(found, rest, SETTINGS).verdict == "ok"
