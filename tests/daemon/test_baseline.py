"""The baseline of an untouched pad: how fast and how far it follows the readings."""

import numpy as np
import pytest

from daemon.pad.baseline import Baseline


def known(rest: float = 10.0) -> Baseline:
    baseline = Baseline()
    baseline.calibrate(np.full((27, 64), rest, np.float32))
    return baseline


def test_light_contact_of_a_second_hardly_moves_the_rest() -> None:
    baseline = known()
    for _ in range(54):
        baseline.track(np.full(64, 20.0, np.float32))
    np.testing.assert_allclose(baseline.counts, 10.0 + 1 / 3, atol=0.02)


def test_the_rest_follows_a_drift_of_a_third_count_a_second() -> None:
    baseline = known()
    for frame in range(54 * 30):
        baseline.track(np.full(64, 10.0 + 0.3 * frame / 54, np.float32))
    assert baseline.counts.mean() == pytest.approx(10.0 + 9.0, abs=1.2)


def test_sway_is_kept_for_a_while_and_bounded() -> None:
    baseline = known()
    baseline.track_sway(np.full(64, 9.0, np.float32))
    assert baseline.sway.max() == 4.0
    for _ in range(9 * 60):
        baseline.track_sway(np.zeros(64, np.float32))
    assert baseline.sway.max() < 0.5


def test_the_noise_floor_lies_above_the_sway() -> None:
    baseline = known()
    baseline.track_sway(np.full(64, 3.0, np.float32))
    baseline.track(np.full(64, 10.0, np.float32))
    np.testing.assert_allclose(baseline.noise_floor, 3.9, rtol=1e-5)
