"""Simulated recordings: reproducible, and recognised as intended; the simulated pad."""

from pathlib import Path

import numpy as np
import pytest

from touchd.daemon.playback.stream import DEMO_RECORDING as DEMO
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.recording import Recording, read_recordings
from touchd.model.classifier import Classifier
from touchd.model.studies.simulated import DEMO_SCRIPT, DEMO_SEED, GESTURES, simulate, write_simulated

TOUCHES = sorted(set(GESTURES) - {"notouch"})
FINAL_FRAMES = 144


@pytest.fixture(scope="module")
def demo() -> list[Recording]:
    return read_recordings(DEMO)


@pytest.mark.parametrize("gesture", TOUCHES)
def test_a_touch_begins_and_ends_at_rest(gesture: str) -> None:
    before, touch, _ = simulate([("notouch", 2.0), (gesture, 2.0), ("notouch", 1.0)], seed=2)
    rise = touch.counts - before.counts.mean(axis=0)
    assert abs(rise[[0, -1]].mean()) < 0.5
    assert rise.mean() > 0.5


def test_a_simulated_pad_at_rest_is_like_a_real_one() -> None:
    """HAART's recordings at rest, 5th to 95th percentile: means of 0.7 to 7.2 counts, noise of 0.5 to 0.9."""
    for seed in range(10):
        (recording,) = simulate([("notouch", 4.0)], seed)
        counts = recording.counts.astype(np.float64)
        assert 0.7 < counts.mean() < 7.2
        assert 0.5 < np.median(counts.std(axis=0)) < 0.9
        assert counts.mean(axis=0).std() > 0.5
        assert counts.max() < 28


def test_the_demo_has_each_gesture_once_within_45_seconds(demo: list[Recording]) -> None:
    gestures = [recording.gesture for recording in demo]
    assert sorted(gestures[1::2]) == TOUCHES
    assert set(gestures[::2]) == {"notouch"}
    assert len(demo[0].counts) >= 2.0 * FRAME_RATE_HZ
    assert demo[-1].sensor_ms[-1] < 45_000


def test_the_demo_recording_is_reproducible_from_its_seed(demo: list[Recording]) -> None:
    made = simulate(DEMO_SCRIPT, DEMO_SEED)
    assert [recording.gesture for recording in made] == [recording.gesture for recording in demo]
    for fresh, shipped in zip(made, demo, strict=True):
        assert fresh.counts.tobytes() == shipped.counts.tobytes()
        np.testing.assert_array_equal(fresh.sensor_ms, shipped.sensor_ms)


def test_the_demo_recording_is_small_and_says_simulated(tmp_path: Path) -> None:
    assert DEMO.stat().st_size < 400_000
    plain = tmp_path / "demo.csv"
    write_simulated(plain, [("notouch", 0.1)], seed=5)
    head = [line for line in plain.read_text().splitlines() if line.startswith("#")]
    assert head[0].startswith("# source: SIMULATED")
    assert "# seed: 5" in head
    assert "# licence: Apache-2.0" in head


def test_the_shipped_model_names_every_part_of_the_demo(
    classifier: Classifier, demo: list[Recording]
) -> None:
    answers = [classifier.probabilities(recording.counts[:FINAL_FRAMES]).argmax() for recording in demo]
    assert [classifier.labels[answer] for answer in answers] == [recording.gesture for recording in demo]
