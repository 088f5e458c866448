"""Mains hum and a motor's vibration are removed from the grid's frames, and nothing else."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.made_pad import MadePad, Scans, nothing, palm, pat

from touchd.drivers.frame import Counts, Frame
from touchd.drivers.pad.grid import Ring
from touchd.drivers.recording import ideal_clock_ms

MOTOR_WEIGHTS = np.random.default_rng(3).uniform(0.5, 1.5, (8, 8)).astype(np.float32)


def hum(frames: int, hz: float = 50.0, counts: float = 2.0) -> Scans:
    wave = counts * np.sin(2 * np.pi * hz * np.arange(frames) / 54)
    return np.broadcast_to(wave[:, None, None], (frames, 8, 8)).astype(np.float32)


def motor(frames: int) -> Scans:
    return MOTOR_WEIGHTS * hum(frames, 23.0)


def hand_over_most(seconds: float) -> Scans:
    """A hand that strokes over 42 taxels, up and down at 3 Hz."""
    scans = nothing(seconds)
    scans[:, 1:7, :7] = 40.0 + 25.0 * np.sin(2 * np.pi * 3.0 * np.arange(len(scans)) / 54)[:, None, None]
    return scans


def laid(counts: Counts) -> NDArray[np.float32]:
    """Return the grid's frames (T, 8, 8) for counts at 54 Hz."""
    ring = Ring(capacity=1)
    stamps = ideal_clock_ms(len(counts)).tolist()
    frames = [ring.push(Frame(ms, 0.0, counts[n]))[0] for n, ms in enumerate(stamps)]
    return np.stack([frame.pressure for frame in frames])


def off(clean: Counts, shaken: Counts) -> tuple[float, float]:
    """Return a vibration's mean error in the last frames, in counts: raw and on the grid."""
    last = slice(-108, None)
    raw = np.abs(shaken[last].astype(np.float32) - clean[last]).mean()
    return float(raw), float(np.abs(laid(shaken)[last] - clean[last]).mean())


def at_rest_and(vibration: Scans) -> tuple[Counts, Counts]:
    """Return counts of a pad at rest, and of one that vibrates."""
    return MadePad().counts(nothing(len(vibration) / 54)), MadePad().counts(vibration)


def steps_of_the_whole_pad() -> Scans:
    steps = nothing(20.0)
    steps[200:500] = 4.0
    return steps


@pytest.mark.parametrize(
    "pressure",
    [
        *(nothing(20.0), pat(20.0), palm(20.0), hand_over_most(20.0)),
        steps_of_the_whole_pad(),
        *(hum(540, hz, 30.0) for hz in (2.0, 26.0, 81.2)),
    ],
    ids=["rest", "pat", "palm", "hand", "steps", "2 Hz", "26 Hz", "81.2 Hz"],
)
def test_frames_without_vibration_are_left_alone(pressure: Scans) -> None:
    counts = MadePad().counts(pressure)
    assert np.array_equal(laid(counts), counts)


@pytest.mark.parametrize("vibration", [hum(540), hum(540, 49.8), hum(540, counts=4.0), motor(540)])
def test_a_vibration_of_the_whole_pad_is_removed(vibration: Scans) -> None:
    raw, left = off(*at_rest_and(vibration))
    assert left < 0.5 * raw


@pytest.mark.parametrize("stuck_at", [0, 200])
@pytest.mark.parametrize("vibration", [hum(540), motor(540)])
def test_a_broken_row_hides_no_vibration(vibration: Scans, stuck_at: int) -> None:
    clean, shaken = at_rest_and(vibration)
    clean[:, 3] = shaken[:, 3] = stuck_at
    assert (laid(shaken)[-108:, 3] == stuck_at).all()
    raw, left = off(clean, shaken)
    assert left < 0.5 * raw


@pytest.mark.parametrize("hz", [18.0, 180.0])
def test_a_coarsely_quantised_sine_is_removed(hz: float) -> None:
    raw, left = off(*at_rest_and(hum(540, hz)))
    assert left < 0.7 * raw


def test_a_saturated_taxel_under_hum_stays_in_range() -> None:
    pressed = nothing(10.0)
    pressed[270:, 3:5, 3:5] = 1023.0
    frames = laid(MadePad().counts(pressed + hum(540)))
    assert frames.min() >= 0
    assert frames.max() == 1023


def test_a_pad_clipped_at_the_top_stays_finite() -> None:
    counts = 500.0 + hum(540, counts=3.0)
    counts[265:, :5] += 523.0
    assert np.isfinite(laid(np.clip(np.rint(counts), 0, 1023).astype(np.uint16))).all()


@pytest.mark.parametrize("vibration", [hum(540), motor(540)])
def test_a_hand_over_most_of_a_vibrating_pad_is_kept(vibration: Scans) -> None:
    hand = np.concatenate([nothing(6.0), hand_over_most(4.0)])
    raw, left = off(MadePad().counts(hand), MadePad().counts(hand + vibration))
    assert left < 0.5 * raw


def test_a_vibration_is_forgotten_a_second_after_it_ends() -> None:
    vibration = np.concatenate([hum(270), nothing(5.0)])
    counts = MadePad().counts(vibration)
    frames = laid(counts)
    assert not np.array_equal(frames[200:270], counts[200:270])
    assert np.array_equal(frames[324:], counts[324:])


def test_after_a_gap_the_vibration_is_learned_again() -> None:
    counts = MadePad().counts(hum(324))
    ring = Ring(capacity=1)
    stamps = ideal_clock_ms(324) + np.where(np.arange(324) < 300, 0, 5000)
    frames = [ring.push(Frame(int(ms), 0.0, counts[n]))[-1] for n, ms in enumerate(stamps)]
    assert np.array_equal(frames[-1].pressure, counts[-1])
