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


def test_a_sound_pad_at_rest_has_only_living_taxels() -> None:
    sound = sample(resting())
    checks = [check_quiet(sound, SETTINGS), check_rest(sound, SETTINGS), check_noise(sound)]
    assert [check.verdict for check in [*checks, *check_taxels(sound)]] == ["ok"] * 4


@pytest.mark.parametrize(
    ("damaged", "stuck_at", "found"),
    [(np.s_[:, 3], 0, "row 4"), (np.s_[:, 2, 4], 7, "row 3 column 5")],
    ids=["a dead row", "a stuck taxel"],
)
def test_broken_taxels_are_named(damaged: tuple[slice | int, ...], stuck_at: int, found: str) -> None:
    counts = resting()
    counts[damaged] = stuck_at
    troubles = check_taxels(sample(counts))
    assert any(found in trouble.found and trouble.advice for trouble in troubles)
    assert {trouble.verdict for trouble in troubles} == {"to do"}


def test_taxels_are_not_checked_on_too_little_data() -> None:
    assert check_taxels(sample(resting(3.0)))[0].verdict == "not checked"
    assert check_taxels(sample(np.zeros_like(resting())))[0].verdict == "warning"


def test_a_noisy_taxel_is_distinguished_from_a_noisy_pad() -> None:
    rng = np.random.default_rng(1)
    counts = resting()
    counts[:, 6, 1] += rng.integers(0, 40, len(counts)).astype(np.uint16)
    one = check_noise(sample(counts))
    assert "row 7 column 2 is noisy" in one.found
    everywhere = check_noise(sample(counts + rng.integers(0, 40, counts.shape).astype(np.uint16)))
    assert "the whole pad is noisy" in everywhere.found


def hum(counts: Counts) -> None:
    at_s = np.arange(len(counts)) / 54
    weights = np.random.default_rng(2).uniform(0.7, 1.3, (8, 8))
    counts += np.rint(6 + 5 * np.sin(2 * np.pi * 4.0 * at_s)[:, None, None] * weights).astype(np.uint16)


def loose_row(counts: Counts) -> None:
    jumps = np.arange(len(counts)) // 54 % 2
    counts[:, 2] += (6 * jumps)[:, None].astype(np.uint16)


def press(counts: Counts) -> None:
    counts[100:200, 2:6, 2:6] += 300


@pytest.mark.parametrize(
    ("disturb", "found"),
    [
        (hum, "all taxels swing together by 5."),
        (hum, "at 4 Hz as sampled: mains hum, or a motor"),
        (loose_row, "the values of row 3 jump together"),
        (press, ""),
        (lambda counts: None, ""),
    ],
    ids=["hum", "its rate", "a loose line", "a press", "nothing"],
)
def test_hum_and_a_loose_line_are_named(disturb: Callable[[Counts], None], found: str) -> None:
    counts = resting()
    disturb(counts)
    check = check_noise(sample(counts))
    assert found in check.found
    assert bool(found) == ("swing" in check.found or "jump" in check.found)
    assert bool(check.advice) >= bool(found)


def short(counts: Counts) -> None:
    counts[:, :, :3] = 1023


def jumping(counts: Counts) -> None:
    counts[1::2, 2:4, 2:4] += np.uint16(300)


@pytest.mark.parametrize(
    ("disturb", "full_scale", "found"),
    [
        (short, 1023, "a quarter of the pad or more is at its limit"),
        (jumping, 1023, "values jump from frame to frame, as no hand makes them"),
        (press, 500, "values above full_scale 500 are cut to it"),
        (press, 1023, ""),
    ],
    ids=["a short", "jumps", "above full scale", "a press"],
)
def test_values_that_no_hand_makes_are_named(
    disturb: Callable[[Counts], None], full_scale: int, found: str
) -> None:
    counts = resting()
    disturb(counts)
    seen = sample(counts)
    if full_scale < 1023:
        seen = replace(seen, clipped=0.2)
    assert [check.found for check in check_values(seen, full_scale)] == ([found] if found else [])


def test_an_inverted_pad_is_distinguished_from_a_loaded_one() -> None:
    upside_down = check_rest(sample(np.uint16(1023) - resting()), SETTINGS)
    assert upside_down.advice == TURN_OVER
    counts = resting()
    counts[:, 1, 2] += 200
    assert "something lies on row 2 column 3" in check_rest(sample(counts), SETTINGS).found


def test_a_high_rest_is_distinguished_from_a_load() -> None:
    rest = np.random.default_rng(1).uniform(60, 180, (8, 8)).astype(np.uint16)
    high = check_rest(sample(resting() + rest), SETTINGS)
    assert high.verdict == "ok"
    assert "what a touch adds to that is recognised" in high.found
    rest[4, 5] = 600
    assert "something lies on row 5 column 6" in check_rest(sample(resting() + rest), SETTINGS).found


@pytest.mark.parametrize(("sensitivity", "advised"), [("normal", True), ("low", False)])
def test_a_touch_during_the_rest_check_is_reported(sensitivity: Sensitivity, advised: bool) -> None:
    script = (("notouch", 3.0), ("rub", 2.0), ("notouch", 2.0))
    counts = np.concatenate([recording.counts for recording in simulate(script, seed=3)])
    settings = msgspec.structs.replace(SETTINGS, touch=TouchSettings(sensitivity=sensitivity))
    check = check_quiet(sample(counts), settings)
    assert check.found == "a touch was detected while listening"
    assert "loose wire" in check.advice
    assert ("touch.sensitivity" in check.advice) == advised


@pytest.mark.parametrize(
    ("row", "column", "verdict", "advice"),
    [(0, 1, "ok", ""), (7, 7, "to do", "add 180"), (0, 7, "to do", "add 270"), (7, 0, "to do", "add 90")],
)
def test_the_pressed_corner_tells_how_the_pad_lies(row: int, column: int, verdict: str, advice: str) -> None:
    counts = resting(1.0)
    rest = np.median(counts, axis=0)
    counts[-10:, row, column] += 300
    pressed = sample(counts)
    assert is_pressed(pressed.frames[-1], rest)
    check = check_orientation(pressed, rest, SETTINGS)
    assert check.verdict == verdict
    assert advice in check.advice


def test_a_press_elsewhere_than_on_a_corner_is_said() -> None:
    counts = resting(1.0)
    rest = np.median(counts, axis=0)
    counts[10:20, 3, 5] += 300
    elsewhere = sample(counts)
    assert not any(is_pressed(frame, rest) for frame in elsewhere.frames)
    check = check_orientation(elsewhere, rest, SETTINGS)
    assert (check.verdict, check.found) == ("not checked", "pressed elsewhere, at row 4 column 6")


def test_not_pressing_the_corner_is_no_fault() -> None:
    counts = resting(20.0)
    counts[100:, 0, 0] += 300
    with pad_of(counts, speed=4.0) as port, open_port(port.path, 512_000) as opened:
        parser = FrameParser(SETTINGS.sensor.described)
        rest = np.median(counts[:100], axis=0)
        found = listen(opened, parser, 15.0, enough=lambda frame: is_pressed(frame, rest))
    assert check_orientation(found, rest, SETTINGS).verdict == "ok"
    untouched = sample(resting(1.0))
    rest = np.median(untouched.counts(), axis=0)
    assert check_orientation(untouched, rest, SETTINGS).verdict == "not checked"


def test_values_that_fall_under_the_hand_are_upside_down() -> None:
    counts = resting(1.0) + 500
    rest = np.median(counts, axis=0)
    counts[-10:, 0, 0] -= 300
    check = check_orientation(sample(counts), rest, SETTINGS)
    assert (check.verdict, check.advice) == ("to do", TURN_OVER)
