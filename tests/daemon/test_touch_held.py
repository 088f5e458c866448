"""What holds while a touch lasts, and what ends it, on a made pad with HAART's noise."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.made_pad import Scans, nothing, palm
from rigs.tracked_pad import TrackedPad

from touchd.daemon.path.tracker.tracker import Onset, Release, TouchSettings, beyond_one_wire, drift_of


class Network:
    """Answers with `no_touch`; windows: the lengths of those that it was asked about."""

    no_touch = 0.9

    def __init__(self) -> None:
        self.windows: list[int] = []

    def __call__(self, window: NDArray[np.float32]) -> float:
        self.windows.append(len(window))
        return self.no_touch


def sees_what_varies(window: NDArray[np.float32]) -> float:
    """A network that takes a pad whose mean varied for a touch."""
    return 0.02 if np.ptp(window.mean(axis=(1, 2))) > 1.2 else 0.9


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
    """A pad that the network knows."""
    pad = TrackedPad(p_no_touch=network)
    assert pad.feel(2.0) == []
    return pad


def creeping(seconds: float, counts: float) -> Scans:
    """What a hug leaves on a soft pad, and gives back slowly."""
    frames = np.arange(round(54 * seconds), dtype=np.float32)
    return palm(seconds, counts, trembling=False) * np.exp(-frames / 200)[:, None, None]


def test_a_touch_ends_after_its_quiet_time() -> None:
    pad = TrackedPad()
    pad.feel(2.0)
    pad.feel(palm(1.0, 60.0))
    # Contact is seen a frame late.
    assert pad.feel(nothing(43 / 54)) == []
    (release,) = pad.feel(nothing(1 / 54))
    assert isinstance(release, Release)


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
    pad.feel(nothing(1.0))
    assert network.windows == []
    pad.feel(0.5)
    assert network.windows != []


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
    seen.feel(palm(1.0, counts=50.0))
    eased = seen.index
    # Far below half of the touch's contact, and seen all the same.
    assert seen.feel(palm(3.0, counts=15.0)) == []
    assert seen.tracker.last_contact_index == seen.index - 1 > eased


def test_what_a_touch_leaves_on_a_finer_pad_ends_it(network: Network) -> None:
    pad = TrackedPad(p_no_touch=network, is_finer=True)
    pad.feel(2.0)
    network.no_touch = 0.02
    pad.feel(palm(1.0, counts=90.0))
    left = pad.index
    # The network, which never saw such a pad, takes it for a hand.
    (release,) = pad.feel(palm(3.0, counts=15.0, trembling=False))
    assert isinstance(release, Release)
    assert abs(release.last_index - left) <= 9


def test_a_hand_that_presses_again_goes_on_with_its_touch(pad: TrackedPad) -> None:
    pad.feel(palm(2.0, counts=200.0), palm(0.6, counts=40.0))
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
    began, beside = pad.index, box[:27].copy()
    beside[:, 5:8, 0:3] += palm(0.5, 7.0)[:, 2:5, 3:6]
    assert pad.feel(beside) == [Onset(began)]


def test_a_slow_press_on_a_pad_that_rests_high_is_a_touch() -> None:
    pad = TrackedPad()
    pad.rest += 400
    pad.feel(2.0)
    assert isinstance(pad.feel(rising(8 * 54, 30.0))[0], Onset)


def test_after_a_touch_that_ended_on_new_rest_the_network_still_knows_the_pad(
    seen: TrackedPad, network: Network
) -> None:
    network.no_touch = 0.02
    seen.feel(palm(2.0, counts=100.0))
    network.no_touch = 0.9
    fold = palm(4.0, counts=6.0, trembling=False)
    assert [type(change) for change in seen.feel(fold[:108])] == [Release]
    network.no_touch = 0.02
    assert [type(change) for change in seen.feel(fold[:108] + np.float32(0.5))] == [Onset]


@pytest.mark.parametrize("gap_ms", [400.0, 5000.0])
def test_a_gap_while_rest_is_measured_begins_the_measurement_again(gap_ms: float) -> None:
    pad = TrackedPad()
    pad.rest += 40
    assert pad.feel(0.3) == []
    pad.gap_ms += gap_ms
    assert pad.feel(nothing(2.0), restarted=True) == []
    assert pad.feel(palm(0.2)) == [Onset(pad.index - 11)]


def test_contact_before_a_gap_does_not_count_after_it(seen: TrackedPad, network: Network) -> None:
    network.no_touch = 0.9
    assert seen.feel(palm(0.3, counts=6.0, trembling=False)) == []
    seen.gap_ms += 400.0
    began = seen.index
    network.no_touch = 0.02
    (onset,) = seen.feel(palm(1.2, counts=8.0), restarted=True)
    assert onset.first_index >= began


def rising(frames: int, counts: float) -> Scans:
    hand = palm(frames / 54, 0.0, trembling=False)
    hand[:, 2:5, 3:6] = np.linspace(0, counts, frames, dtype=np.float32)[:, None, None]
    return hand


def test_a_light_hand_that_moves_at_once_needs_no_network(seen: TrackedPad) -> None:
    began, moving = seen.index, rising(5, 7.5)
    moving[:, 2:5, 3:6] += 3.0
    (onset,) = seen.feel(palm(4 / 54, 3.0, trembling=False), moving)
    assert abs(onset.first_index - began) <= 2


def test_contact_that_moves_late_needs_the_network(seen: TrackedPad, network: Network) -> None:
    steady, moving = palm(0.3, 4.5, trembling=False), rising(20, 4.0)
    moving[:, 2:5, 3:6] += 4.5
    assert seen.feel(steady, moving) == []
    network.no_touch = 0.02
    assert isinstance(seen.feel(palm(0.3, 8.5))[0], Onset)


def test_a_tap_that_leaves_a_little_is_noticed_at_once() -> None:
    pad = TrackedPad(p_no_touch=sees_what_varies)
    pad.feel(3.0)
    began = pad.index
    (onset,) = pad.feel(np.full((6, 8, 8), 4.0, np.float32), np.full((18, 8, 8), 2.3, np.float32))
    assert abs(onset.first_index - began) <= 2


def test_a_longer_tap_is_asked_about_from_its_beginning(network: Network) -> None:
    pad = TrackedPad(p_no_touch=network)
    pad.feel(3.0)
    network.windows.clear()
    pad.feel(np.full((10, 8, 8), 4.0, np.float32), nothing(14 / 54))
    # The tap, a quarter of a second after it, and two frames before it.
    assert 24 <= max(length for length in network.windows if length != 54) <= 27


@pytest.mark.parametrize(("counts", "goes_on"), [(50.0, True), (300.0, False)], ids=["a hand", "a hug"])
def test_on_a_finer_pad_the_network_prolongs_no_hug(network: Network, counts: float, goes_on: bool) -> None:
    pad = TrackedPad(p_no_touch=network, is_finer=True)
    pad.feel(3.0)
    network.no_touch = 0.02
    pad.feel(palm(1.5, counts))
    assert (pad.feel(1.5) == []) == goes_on


def test_a_touch_that_ends_by_stillness_is_dated_soon_after_the_hand(
    seen: TrackedPad, network: Network
) -> None:
    network.no_touch = 0.02
    seen.feel(palm(2.0, counts=100.0))
    left = seen.index
    (release,) = seen.feel(palm(3.0, counts=13.0, trembling=False))
    assert -1 <= release.last_index - left <= 27


@pytest.mark.parametrize(("risen", "drift"), [(31, 0.0), (32, 5.0), (64, 5.0)])
def test_drift_is_what_half_of_the_taxels_share(risen: int, drift: float) -> None:
    rise = np.zeros(64, np.float32)
    rise[:risen] = 5.0
    assert drift_of(rise) == drift
    assert drift_of(-rise) == 0.0


@pytest.mark.parametrize(
    ("rows", "columns", "contact"),
    [
        (slice(2, 3), slice(0, 8), 7.0),
        (slice(0, 8), slice(5, 6), 7.0),
        (slice(2, 3), slice(0, 2), 0.0),
        (slice(2, 4), slice(0, 8), 39.0),
        (slice(2, 4), slice(3, 5), 8.0),
    ],
    ids=["a row", "a column", "part of a row", "two rows", "a finger"],
)
def test_what_a_loose_wire_may_lift_is_no_contact(rows: slice, columns: slice, contact: float) -> None:
    above = np.zeros((8, 8), np.float32)
    above[rows, columns] = 4.0
    assert beyond_one_wire(above.ravel()) == contact


def test_moving_contact_is_asked_about_from_a_third_of_a_second_on(network: Network) -> None:
    after: list[int] = []
    for shift in range(9):
        network.no_touch = 0.9
        pad = TrackedPad(p_no_touch=network)
        pad.feel(nothing(2.0 + shift / 54))
        network.no_touch = 0.3
        after.append(next(number for number, scan in enumerate(palm(1.0, 5.0)) if pad.feel(scan[None])))
    # It is asked six times a second, and contact is seen a frame late.
    assert sorted(after) == list(range(19, 28))


def test_the_sway_of_a_body_that_breathes_is_learned(pad: TrackedPad) -> None:
    still = float(pad.tracker.baseline.sway.max())
    breathing = 1.2 - 1.2 * np.cos(2 * np.pi * 0.5 * np.arange(54 * 10, dtype=np.float32) / 54)
    pad.feel(nothing(10.0) + breathing[:, None, None])
    assert still < 0.8
    assert 1.0 < pad.tracker.baseline.sway.mean() < 2.5


def test_beside_an_object_the_network_is_asked_about_light_contact(
    seen: TrackedPad, network: Network
) -> None:
    box = palm(14.0, counts=200.0, trembling=False)
    assert [type(change) for change in seen.feel(box)] == [Onset, Release]
    network.no_touch = 0.02
    began, beside = seen.index, box[:32].copy()
    beside[:, 5:8, 0:3] += palm(32 / 54, 4.0)[:, 2:5, 3:6]
    (onset,) = seen.feel(beside)
    assert abs(onset.first_index - began) <= 2


def swaying(seconds: float, counts: float) -> Scans:
    """A load that moves by little more than what counts as still."""
    scans = palm(seconds, counts, trembling=False)
    scans[:, 2:5, 3:6] += 1.5 * np.sin(np.arange(len(scans), dtype=np.float32) / 9)[:, None, None]
    return scans


@pytest.mark.parametrize("shift", range(0, 18, 3))
def test_the_network_ends_a_touch_once_it_saw_three_seconds_without_a_hand(
    seen: TrackedPad, shift: int
) -> None:
    # The last seconds, a third of a second apart; none holds what came before the touch.
    seen.feel(nothing(shift / 54))
    (onset,) = seen.feel(palm(4 / 54, 16.0), swaying(1.4, 7.0))
    assert isinstance(onset, Onset)
    (release,) = seen.feel(swaying(0.6, 7.0))
    assert isinstance(release, Release)


def test_on_a_finer_pad_the_network_prolongs_nothing_heavy(network: Network) -> None:
    pad = TrackedPad(p_no_touch=network, is_finer=True)
    pad.feel(3.0)
    network.no_touch = 0.02
    pad.feel(palm(1.5, 60.0))
    left = pad.index
    (release,) = pad.feel(swaying(1.0, 16.0))
    assert abs(release.last_index - left) <= 2


def test_an_object_that_became_rest_is_no_hand_even_if_the_network_sees_one_later(
    seen: TrackedPad, network: Network
) -> None:
    network.no_touch = 0.3
    _, release = seen.touched(palm(11.0, counts=60.0, trembling=False))
    assert release.reason == "settled"
    network.no_touch = 0.02
    assert seen.feel(palm(5.0, counts=60.0, trembling=False)) == []


def test_a_light_touch_just_after_an_object_became_rest_is_detected(pad: TrackedPad) -> None:
    box = palm(11.0, counts=200.0, trembling=False)
    pad.touched(box)
    began, beside = pad.index, box[:36].copy()
    beside[:, 5:8, 0:3] += np.linspace(3.0, 6.3, 36, dtype=np.float32)[:, None, None]
    (onset,) = pad.feel(beside)
    assert abs(onset.first_index - began) <= 5


def test_a_pad_that_reads_less_is_at_rest_again_after_half_a_second(pad: TrackedPad) -> None:
    pad.rest += 30
    pad.feel(2.0)
    pad.rest -= 20
    before = pad.tracker.baseline.counts.mean()
    # The median delays by a frame.
    pad.feel(nothing(27 / 54))
    assert before - pad.tracker.baseline.counts.mean() < 1.0
    pad.feel(nothing(1 / 54))
    assert before - pad.tracker.baseline.counts.mean() == pytest.approx(20.0, abs=1.0)


def test_a_light_pat_that_is_noticed_late_ends_at_once_with_a_short_quiet_time() -> None:
    pad = TrackedPad(TouchSettings(quiet_s=0.1), p_no_touch=sees_what_varies)
    pad.feel(3.0)
    began = pad.index
    # It is noticed a quarter of a second after it, when the quiet time has passed.
    onset, release = pad.feel(np.full((6, 8, 8), 4.0, np.float32), nothing(0.4))
    assert isinstance(onset, Onset)
    assert isinstance(release, Release)
    assert abs(release.last_index - (began + 6)) <= 2


def test_the_network_is_not_asked_about_a_quiet_time_that_is_too_short(network: Network) -> None:
    pad = TrackedPad(TouchSettings(quiet_s=0.2), p_no_touch=network)
    pad.feel(3.0)
    network.no_touch = 0.02
    pad.feel(palm(0.8, 60.0))
    network.windows.clear()
    (release,) = pad.feel(nothing(0.25))
    assert isinstance(release, Release)
    assert network.windows == []


def test_contact_that_rose_and_then_stays_becomes_rest(seen: TrackedPad) -> None:
    before = seen.tracker.baseline.counts.mean()
    slow = rising(70, 4.0)
    stays = np.repeat(slow[-1:], 81, axis=0)
    assert seen.feel(slow, stays) == []
    assert seen.tracker.baseline.counts.mean() - before == pytest.approx(9 * 4.0 / 64, abs=0.1)


def test_a_touch_that_the_network_saw_ends_a_third_of_a_second_after_it_saw_it_last(
    seen: TrackedPad, network: Network
) -> None:
    network.no_touch = 0.02
    seen.feel(palm(1.0, 60.0))
    assert seen.feel(nothing(50 / 54)) == []
    network.no_touch = 0.9
    (release,) = seen.feel(nothing(18 / 54))
    assert isinstance(release, Release)


def test_an_object_that_lies_still_does_not_count_as_sway(pad: TrackedPad) -> None:
    pad.touched(palm(11.0, counts=200.0, trembling=False))
    assert pad.tracker.baseline.sway.max() < 0.8


def test_light_contact_that_rises_by_half_in_a_second_does_not_become_rest(seen: TrackedPad) -> None:
    before = seen.tracker.baseline.counts.mean()
    slow = palm(1.5, 0.0, trembling=False)
    slow[:, 2:5, 3:6] = 4.0 * 1.6 ** (np.arange(len(slow), dtype=np.float32) / 54)[:, None, None]
    assert seen.feel(slow) == []
    assert seen.tracker.baseline.counts.mean() - before < 0.1


def test_the_network_follows_a_touch_three_times_a_second(network: Network) -> None:
    pad = TrackedPad(p_no_touch=network)
    pad.feel(nothing(110 / 54))
    network.no_touch = 0.02
    pad.feel(palm(2.0, 4.0))
    network.windows.clear()
    assert pad.feel(palm(2.0, 4.0)) == []
    assert network.windows.count(54) == 6


@pytest.mark.parametrize(("left", "ends"), [(140.0, True), (170.0, False)])
def test_what_is_below_half_of_a_touch_less_a_light_hand_is_what_it_left(left: float, ends: bool) -> None:
    pad = TrackedPad()
    pad.rest = np.full((8, 8), 20.0)
    pad.feel(2.0)
    floor = 9 * pad.tracker.baseline.noise_floor.mean()

    def load(seconds: float, contact: float) -> Scans:
        return palm(seconds, (contact + floor) / 9, trembling=False)

    # Half of 360 less 60 is 150. Still, and above a light hand, it would end later.
    assert [type(change) for change in pad.feel(load(1.5, 360.0), load(0.95, left))] == (
        [Onset, Release] if ends else [Onset]
    )


def test_a_touch_that_only_the_network_sees_is_asked_about_three_times_a_second(
    seen: TrackedPad, network: Network
) -> None:
    network.no_touch = 0.02
    seen.feel(palm(0.9, 60.0), nothing(45 / 54))
    network.windows.clear()
    seen.feel(nothing(1.0))
    assert 2 <= network.windows.count(36) <= 3
