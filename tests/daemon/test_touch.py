"""When a touch begins and ends, on a made pad with HAART's noise: a newcomer sees each rule at work."""

from __future__ import annotations

import numpy as np
import pytest
from rigs.made_pad import MadePad, Scans, nothing, palm, pat

from daemon.touch import Onset, Release, TouchSettings, TouchTracker
from drivers.pad.grid import GridFrame


class Pad(MadePad):
    """A tracker with a pad before it."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed)
        self.tracker = TouchTracker(TouchSettings())
        self.index = 0
        self.gap_ms = 0.0

    def feel(self, *pressures: Scans | float, restarted: bool = False) -> list[Onset | Release]:
        """Lay scans (T, 8, 8), or seconds of nothing, on the pad; return what the tracker says."""
        changes = []
        for pressure in pressures:
            scans = nothing(pressure) if isinstance(pressure, float) else pressure
            for counts in self.counts(scans).astype(np.float32):
                sensor_ms = self.index * 1000 / 54 + self.gap_ms
                change = self.tracker.update(GridFrame(self.index, sensor_ms, 0.0, counts, False, restarted))
                changes += [change] if change else []
                self.index += 1
                restarted = False
        return changes


@pytest.fixture
def pad() -> Pad:
    pad = Pad()
    assert pad.feel(2.0) == []
    return pad


def test_a_light_touch_is_noticed_within_100_ms(pad: Pad) -> None:
    began = pad.index
    assert pad.feel(palm(0.1, counts=6.0)) == [Onset(began)]


def test_a_touch_ends_at_its_last_contact(pad: Pad) -> None:
    began = pad.index
    onset, release = pad.feel(palm(1.0), 2.0)
    assert onset == Onset(began)
    assert isinstance(release, Release)
    assert (release.first_index, release.reason) == (began, "released")
    assert release.last_index == began + 53


def test_the_lift_offs_of_a_pat_do_not_split_it(pad: Pad) -> None:
    changes = pad.feel(pat(8.0), 2.0)
    assert [type(change) for change in changes] == [Onset, Release]


def test_a_minute_of_rest_is_no_touch(pad: Pad) -> None:
    assert pad.feel(60.0) == []


@pytest.mark.parametrize("deviation_counts", [2.0, 3.0])
def test_a_noisier_pad_at_rest_is_no_touch(deviation_counts: float) -> None:
    noise = np.random.default_rng(7).normal(0, deviation_counts, (54 * 20, 8, 8)).astype(np.float32)
    assert Pad().feel(noise + 10) == []


def test_a_loose_wire_on_a_row_is_no_touch(pad: Pad) -> None:
    row = np.zeros((27, 8, 8), np.float32)
    row[:, 4] = [1.6, 1.5, 1.9, 2.5, 4.5, 3.3, 3.4, 3.8]
    assert pad.feel(row, 1.0, row, 1.0) == []


def test_a_firm_finger_on_one_row_is_a_touch(pad: Pad) -> None:
    finger = np.zeros((27, 8, 8), np.float32)
    finger[:, 4, 3:5] = 60.0
    assert pad.feel(finger) == [Onset(pad.index - 27)]


def test_a_single_broken_scan_is_no_touch(pad: Pad) -> None:
    broken = np.random.default_rng(5).integers(0, 1000, (1, 8, 8)).astype(np.float32)
    assert pad.feel(broken, 1.0) == []


def test_a_taxel_that_jitters_is_no_touch(pad: Pad) -> None:
    jitter = np.zeros((540, 8, 8), np.float32)
    jitter[:, 1, 1] = np.random.default_rng(6).normal(0, 6, 540)
    assert pad.feel(jitter, 1.0) == []


def test_a_slow_drift_of_the_rest_is_followed(pad: Pad) -> None:
    drift = np.linspace(0, 10, 54 * 60)[:, None, None] * np.ones((8, 8))
    assert pad.feel(drift.astype(np.float32)) == []
    pad.rest += 10
    (onset,) = pad.feel(palm(0.2, counts=8.0))
    assert abs(onset.first_index - (pad.index - 11)) <= 1


def test_a_light_touch_that_lasts_does_not_become_rest(pad: Pad) -> None:
    changes = pad.feel(palm(20.0, counts=6.0), 2.0)
    assert [type(change) for change in changes] == [Onset, Release]


def test_a_hand_there_at_the_start_counts_as_rest() -> None:
    pad = Pad()
    assert pad.feel(palm(5.0, trembling=False), 1.0) == []
    assert pad.feel(palm(0.2)) == [Onset(pad.index - 11)]


def test_a_hand_moving_at_the_start_is_felt() -> None:
    pad = Pad()
    assert [type(change) for change in pad.feel(pat(3.0), 3.0)] == [Onset, Release]
    assert [type(change) for change in pad.feel(palm(1.0), 2.0)] == [Onset, Release]


def test_an_object_left_on_the_pad_becomes_rest(pad: Pad) -> None:
    box = palm(30.0, counts=200.0, trembling=False)
    began = pad.index
    onset, release = pad.feel(box)
    assert onset == Onset(began)
    assert isinstance(release, Release)
    assert release.reason == "settled"
    assert 10.0 <= (release.last_index - began) / 54 <= 11.0
    # A touch beside the object, then the object goes.
    beside = box[:54].copy()
    beside[:, 6:8, 0:2] += 30.0
    assert [type(change) for change in pad.feel(beside, box[:108])] == [Onset, Release]
    assert pad.feel(2.0) == []
    assert pad.feel(palm(0.2)) == [Onset(pad.index - 11)]


def test_a_resting_hand_is_felt_while_it_trembles(pad: Pad) -> None:
    changes = pad.feel(palm(60.0, counts=60.0), 2.0)
    assert [type(change) for change in changes] == [Onset, Release]
    assert isinstance(changes[1], Release)
    assert changes[1].reason == "released"


def test_a_gap_ends_the_touch_and_begins_another(pad: Pad) -> None:
    began = pad.index
    pad.feel(palm(1.0))
    pad.gap_ms += 500.0
    release, onset = pad.feel(palm(1.0), restarted=True)
    assert release == Release(began, began + 53, "gap")
    assert onset == Onset(began + 54)


def test_rest_is_learned_anew_after_a_long_silence(pad: Pad) -> None:
    for gap_ms in (60_000.0, -100_000.0):
        pad.gap_ms += gap_ms
        pad.rest = pad.rest[::-1] + 7
        assert pad.feel(np.zeros((54, 8, 8), np.float32), restarted=True) == []
        assert pad.feel(palm(0.2)) == [Onset(pad.index - 11)]
        pad.feel(2.0)


def test_a_lost_sensor_ends_touch_and_rest(pad: Pad) -> None:
    began = pad.index
    pad.feel(palm(1.0))
    assert pad.tracker.forget("sensor") == Release(began, began + 53, "sensor")
    assert pad.tracker.forget("sensor") is None
    pad.rest += 20
    assert pad.feel(2.0) == []


def test_settings_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ValueError, match="release_level"):
        TouchSettings(onset_level=3.0, release_level=4.0)
