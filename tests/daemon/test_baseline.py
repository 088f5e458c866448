"""What is known of an untouched pad: what it reads, its noise, its sway, its last second."""

import numpy as np
import pytest
from numpy.typing import NDArray

from touchd.daemon.path.tracker.baseline import SECOND_FRAMES, Baseline, LastSecond


def white(deviation: float, frames: int, rest: float = 10.0) -> NDArray[np.float32]:
    noise = np.random.default_rng(3).normal(rest, deviation, (frames, 64))
    return noise.astype(np.float32)


def tracked(frames: NDArray[np.float32], baseline: Baseline | None = None) -> Baseline:
    """Return a baseline that was calibrated on half a second of frames and has followed the others."""
    if baseline is None:
        baseline = Baseline()
        baseline.calibrate(frames[:27])
    for pressure in frames[27:]:
        baseline.track(pressure)
    return baseline


def test_nothing_known_is_a_quiet_pad_at_zero() -> None:
    baseline = Baseline()
    assert baseline.counts.max() == baseline.sway.max() == 0.0
    np.testing.assert_allclose(baseline.noise_floor, 1.6)
    assert not baseline.is_disturbed


def test_rest_is_what_a_taxel_reads_mostly() -> None:
    frames = np.repeat(np.float32([900.0, 10.0, 0.0]), [12, 3, 12])[:, None] + np.zeros(64, np.float32)
    frames[12:15] += np.arange(64, dtype=np.float32)
    baseline = Baseline()
    baseline.shift(frames)
    np.testing.assert_array_equal(baseline.counts, 10.0 + np.arange(64))
    np.testing.assert_allclose(baseline.noise_floor, 1.6)


@pytest.mark.parametrize("seconds", [0.5, 30.0], ids=["calibrated", "followed"])
@pytest.mark.parametrize("deviation", [0.5, 1.5, 2.5, 20.0])
def test_the_noise_floor_is_two_mean_deviations_within_bounds(deviation: float, seconds: float) -> None:
    floor = tracked(white(deviation, round(54 * seconds))).noise_floor
    expected = min(max(2 * deviation * np.sqrt(2 / np.pi), 1.6), 8.0)
    assert floor.mean() == pytest.approx(expected, rel=0.06)
    assert (floor.min() >= 1.6 - 1e-5, floor.max() <= 8.0 + 1e-5) == (True, True)


@pytest.mark.parametrize("before", [0.5, 3.0])
def test_the_noise_floor_follows_the_noise_within_ten_seconds(before: float) -> None:
    after = 3.5 - before
    floor = tracked(np.concatenate([white(before, 54), white(after, 540)])).noise_floor
    assert floor.mean() == pytest.approx(max(2 * after * np.sqrt(2 / np.pi), 1.6), rel=0.12)


@pytest.mark.parametrize(
    ("deviation", "is_disturbed"), [(0.76, False), (1.2, False), (1.6, True), (4.0, True)]
)
def test_only_noise_that_hides_light_touches_disturbs_a_pad(deviation: float, is_disturbed: bool) -> None:
    frames = white(deviation, 54 * 20)
    assert tracked(frames[:27]).is_disturbed == is_disturbed
    assert tracked(frames).is_disturbed == is_disturbed


def test_noise_on_two_taxels_does_not_disturb_a_pad() -> None:
    frames = white(0.76, 54 * 10)
    frames[:, :2] = white(8.0, 54 * 10)[:, :2]
    assert not tracked(frames).is_disturbed


@pytest.mark.parametrize("shift", [20.0, -20.0])
def test_a_rest_that_has_shifted_is_not_noise(shift: float) -> None:
    baseline = tracked(white(0.76, 54))
    tracked(white(0.76, 54 * 3) + np.float32(shift), baseline)
    assert not baseline.is_disturbed
    # It is followed by at most a third of a count in a second.
    assert abs(baseline.counts - 10.0).mean() == pytest.approx(0.85, abs=0.25)
    assert np.sign(baseline.counts.mean() - 10.0) == np.sign(shift)


def test_a_rest_that_rises_while_it_is_measured_is_not_noise() -> None:
    rising = white(0.3, 27) + np.linspace(0, 20, 27, dtype=np.float32)[:, None]
    assert not tracked(rising).is_disturbed


def test_a_small_shift_of_the_rest_is_followed_in_seconds() -> None:
    baseline = tracked(white(0.0, 54))
    tracked(white(0.0, 54 * 3 + 27, rest=10.5), baseline)
    np.testing.assert_allclose(baseline.counts, 10.5 - 0.5 / np.e, atol=0.01)


@pytest.mark.parametrize(("change", "sway"), [(0.5, 0.5), (3.0, 3.0), (30.0, 4.0)])
def test_sway_is_the_largest_recent_change(change: float, sway: float) -> None:
    baseline = tracked(white(0.0, 27))
    for counts in (change, change / 3, 0.0):
        baseline.track_sway(np.full(64, counts, np.float32))
    np.testing.assert_allclose(baseline.sway, sway, rtol=0.02)
    baseline.track(baseline.counts)
    np.testing.assert_allclose(baseline.noise_floor, max(1.6, 1.3 * sway), rtol=0.02)
    # It halves in 23 seconds of six checks.
    for _ in range(138):
        baseline.track_sway(np.zeros(64, np.float32))
    np.testing.assert_allclose(baseline.sway, sway / 2, rtol=0.05)


def second_of(*frames: float) -> LastSecond:
    recent = LastSecond()
    for read in frames:
        recent.push(np.full(64, read, np.float32))
    return recent


@pytest.mark.parametrize("pushed", [1, 53, 54, 55, 107, 108, 109, 200])
def test_the_newest_frames_come_oldest_first(pushed: int) -> None:
    recent = second_of(*range(pushed))
    assert len(recent) == min(pushed, SECOND_FRAMES)
    for wanted in (1, 3, 54, 99):
        newest = recent.last(wanted)[:, 0].tolist()
        assert newest == list(range(pushed))[-min(wanted, SECOND_FRAMES) :]


def test_a_cleared_second_holds_nothing() -> None:
    recent = second_of(*range(60))
    recent.clear()
    assert (len(recent), len(recent.last(5))) == (0, 0)
    recent.push(np.full(64, 7.0, np.float32))
    assert recent.last(5)[:, 0].tolist() == [7.0]


def test_the_halves_differ_by_a_step_and_spread_only_within() -> None:
    recent, size = LastSecond(), np.arange(64, dtype=np.float32)
    for number in range(55):
        recent.push((number - 1) // 27 * 10 + (-1) ** number * size)
    older, newer = recent.halves()
    np.testing.assert_allclose(newer - older, 10 + 2 * size / 27, rtol=1e-4)
    np.testing.assert_allclose(recent.spread(), size, rtol=0.01)
