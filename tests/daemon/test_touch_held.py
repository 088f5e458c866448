"""What holds while a touch lasts, and what ends it, on a made pad with HAART's noise."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.made_pad import Scans, nothing, palm
from rigs.tracked_pad import TrackedPad

from touchd.daemon.tracker.tracker import Onset, Release, TouchSettings


class Network:
    """Answers with `no_touch`; asked: how often."""

    no_touch = 0.9
    asked = 0

    def __call__(self, window: NDArray[np.float32]) -> float:
        self.asked += 1
        return self.no_touch


@pytest.fixture
def network() -> Network:
    return Network()


@pytest.fixture
def pad() -> TrackedPad:
    pad = TrackedPad()
    assert pad.feel(2.0) == []
    return pad


@pytest.fixture
def seen(network: Network) -> TrackedPad:
    """A pad that the network knows well."""
    pad = TrackedPad(p_no_touch=network)
    assert pad.feel(2.0) == []
    return pad


def creeping(seconds: float, counts: float) -> Scans:
    """What a hug leaves on a soft pad, and gives back slowly."""
    frames = np.arange(round(54 * seconds), dtype=np.float32)
    return palm(seconds, counts, trembling=False) * np.exp(-frames / 200)[:, None, None]


def test_nothing_ends_at_rest_and_a_touch_ends_after_its_quiet_time() -> None:
    pad = TrackedPad()
    assert not pad.tracker.is_settled(1)
    pad.feel(2.0)
    assert pad.tracker.is_settled(1000)
    pad.feel(palm(1.0, 60.0))
    assert (pad.tracker.is_settled(42), pad.tracker.is_settled(43)) == (True, False)
    pad.feel(nothing(20 / 54))
    assert (pad.tracker.is_settled(22), pad.tracker.is_settled(24)) == (True, False)
    assert isinstance(pad.feel(1.0)[0], Release)
    assert pad.tracker.is_settled(1000)
    pad.feel(palm(5 / 54, 6.0, trembling=False))
    assert not pad.tracker.is_settled(1)


def test_a_pad_is_untouched_two_seconds_after_the_last_hand(pad: TrackedPad) -> None:
    pad.feel(1.0)
    assert pad.tracker.is_untouched
    pad.feel(palm(1.0))
    assert not pad.tracker.is_untouched
    pad.feel(nothing(0.8 + 1.9))
    assert not pad.tracker.is_untouched
    pad.feel(nothing(0.3))
    assert pad.tracker.is_untouched


def test_the_last_contact_of_a_touch_is_known_while_it_pauses(pad: TrackedPad) -> None:
    for seconds in (0.5, 0.7):
        pad.feel(palm(seconds, 60.0))
        last = pad.index - 1
        assert pad.tracker.last_contact_index == last
        pad.feel(nothing(0.4))
        assert pad.tracker.last_contact_index == last


def test_the_network_is_not_asked_in_the_first_second_of_rest(network: Network) -> None:
    pad = TrackedPad(p_no_touch=network)
    pad.feel(nothing(62 / 54))
    assert network.asked == 0
    pad.feel(1.0)
    assert network.asked > 0


@pytest.mark.parametrize("knows", [True, False], ids=["a known pad", "an unknown pad"])
def test_a_hug_is_dated_by_the_hand_and_not_by_what_it_leaves(network: Network, knows: bool) -> None:
    pad = TrackedPad(p_no_touch=network if knows else None)
    pad.feel(2.0)
    network.no_touch = 0.02
    pad.feel(palm(2.0, counts=300.0))
    left = pad.index
    network.no_touch = 0.9
    (release,) = pad.feel(creeping(3.0, 60.0))
    assert abs(release.last_index - left) <= 9


def test_what_a_light_touch_leaves_on_a_known_pad_is_the_networks_to_judge(
    seen: TrackedPad, network: Network
) -> None:
    network.no_touch = 0.02
    seen.feel(palm(1.0, counts=90.0))
    eased = seen.index
    # Far below half of the touch's contact, and seen all the same.
    assert seen.feel(palm(3.0, counts=15.0)) == []
    assert seen.tracker.last_contact_index == seen.index - 1 > eased


def test_a_hand_that_presses_again_goes_on_with_its_touch(pad: TrackedPad) -> None:
    pad.feel(palm(2.0, counts=200.0), palm(0.6, counts=60.0))
    # Without it, the touch would end at what is far below its highest contact.
    assert pad.feel(palm(0.4, counts=95.0)) == []
    assert isinstance(pad.feel(2.0)[0], Release)


def test_a_firm_hand_that_moves_is_not_ended_by_the_network(seen: TrackedPad) -> None:
    moving = palm(6.0, 150.0)
    moving *= 1 + 0.2 * np.sin(np.arange(len(moving)) / 5)[:, None, None].astype(np.float32)
    began = seen.index
    assert seen.feel(moving) == [Onset(began)]
    left = seen.index
    (release,) = seen.feel(2.0)
    assert abs(release.last_index - left) <= 2


@pytest.mark.parametrize("quiet_s", [0.1, 0.5, 2.0])
def test_a_touch_ends_after_the_quiet_time_that_is_set(quiet_s: float) -> None:
    pad = TrackedPad(TouchSettings(quiet_s=quiet_s))
    pad.feel(2.0)
    pad.feel(palm(1.0, 60.0))
    left = pad.index
    assert pad.feel(nothing(quiet_s - 2 / 54)) == []
    assert pad.feel(nothing(4 / 54)) == [Release(left - 54, left - 1, "released")]


@pytest.mark.parametrize("threshold", [2.0, 20.0, 100.0])
def test_contact_begins_a_touch_from_the_threshold_on(threshold: float) -> None:
    settings = TouchSettings(onset_threshold=threshold)

    def begins(counts: float) -> bool:
        pad = TrackedPad(settings)
        pad.feel(2.0)
        hand = palm(0.3, 0.0, trembling=False)
        hand[:, 2:5, 3:6] = pad.tracker.baseline.noise_floor.reshape(8, 8)[2:5, 3:6] + counts / 9
        return bool(pad.feel(hand * (1 + 0.02 * np.arange(len(hand), dtype=np.float32))[:, None, None]))

    # What a loose wire may lift, 25 counts at most, is not counted.
    assert begins(2.5 * threshold + 60)
    assert not begins(0.2 * threshold)


def test_beside_an_object_that_became_rest_light_touches_are_detected(pad: TrackedPad) -> None:
    box = palm(14.0, counts=200.0, trembling=False)
    _, release = pad.feel(box)
    assert release.reason == "settled"
    beside = box[:27].copy()
    beside[:, 5:8, 0:3] += palm(0.5, 7.0)[:, 2:5, 3:6]
    began = pad.index
    assert pad.feel(beside) == [Onset(began)]
