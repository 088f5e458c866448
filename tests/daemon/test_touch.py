"""The rules for a touch's beginning and end, on a made pad with HAART's noise, and the pad's baseline."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.made_pad import Scans, nothing, palm, pat
from rigs.tracked_pad import TrackedPad

from touchd.daemon.path.tracker.baseline import Baseline, LastSecond
from touchd.daemon.path.tracker.tracker import Onset, Release, TouchSettings
from touchd.model.classifier import Classifier, as_known


@pytest.fixture
def pad() -> TrackedPad:
    pad = TrackedPad()
    assert pad.feel(2.0) == []
    return pad


@pytest.mark.parametrize(("counts", "within_s"), [(12.0, 0.1), (6.5, 0.5)], ids=["firm", "light"])
def test_a_touch_is_detected_at_its_first_frame(pad: TrackedPad, counts: float, within_s: float) -> None:
    began = pad.index
    assert pad.feel(palm(within_s, counts)) == [Onset(began)]


def test_a_touch_ends_at_its_last_contact(pad: TrackedPad) -> None:
    began = pad.index
    assert pad.feel(palm(1.0), 2.0) == [Onset(began), Release(began, began + 53, "released")]


@pytest.mark.parametrize(
    "hand", [pat(8.0), palm(20.0, 6.0), palm(60.0, 60.0)], ids=["lift-offs", "light and long", "trembling"]
)
def test_a_hand_that_keeps_still_is_one_touch(pad: TrackedPad, hand: Scans) -> None:
    _, release = pad.touched(hand, 2.0)
    assert release.reason == "released"


def test_a_gentle_beginning_is_dated_to_its_first_counts(pad: TrackedPad) -> None:
    began, rising = pad.index, np.minimum(np.arange(54, dtype=np.float32) / 27, 1)
    (onset,) = pad.feel(palm(1.0) * rising[:, None, None])
    assert 0 <= onset.first_index - began <= 5


def test_a_hand_that_eases_off_does_not_end_the_touch(pad: TrackedPad) -> None:
    onset, release = pad.touched(palm(2.0, counts=200.0), palm(8.0, counts=120.0), 2.0)
    assert release.last_index - onset.first_index == 10 * 54 - 1


@pytest.mark.parametrize("deviation_counts", [2.0, 3.0])
def test_more_noise_at_rest_begins_no_touch(deviation_counts: float) -> None:
    noise = np.random.default_rng(7).normal(0, deviation_counts, (54 * 20, 8, 8)).astype(np.float32)
    assert TrackedPad().feel(noise + 10) == []


def random(scale: float, *shape: int) -> Scans:
    return np.random.default_rng(6).normal(0, scale, shape).astype(np.float32)


def at(scans: Scans, row: int | slice, column: int | slice, counts: object) -> Scans:
    scans[:, row, column] = counts
    return scans


LOOSE_WIRE = at(nothing(0.5), 4, slice(8), [1.6, 1.5, 1.9, 2.5, 4.5, 3.3, 3.4, 3.8])


def fold(seconds: float, counts: float = 4.0) -> Scans:
    """A fold that a touch left: a third of the pad reads higher, without moving."""
    return at(nothing(seconds), slice(8), slice(2, 5), counts)


def drift(counts_a_second: float) -> Scans:
    return nothing(60.0) + (counts_a_second * np.arange(54 * 60, dtype=np.float32) / 54)[:, None, None]


@pytest.mark.parametrize(
    "scans",
    [
        [60.0],
        [LOOSE_WIRE, 1.0, LOOSE_WIRE, 1.0],
        [np.abs(random(400.0, 1, 8, 8)), 1.0],
        [at(nothing(10.0), 1, 1, random(6.0, 540)), 1.0],
        [fold(10.0, 3.0), 10.0, fold(10.0, 3.0)],
        [drift(0.2)],
        [drift(1.0)],
        [nothing(10.0) + 40.0, 10.0],
    ],
    ids=[
        "rest",
        "loose wire",
        "broken scan",
        "jittery taxel",
        "shifted rest",
        "slow drift",
        "drift",
        "supply step",
    ],
)
def test_a_pad_that_nobody_touches_reports_no_touch(pad: TrackedPad, scans: list[Scans | float]) -> None:
    assert pad.feel(*scans) == []


def test_a_touch_after_a_supply_step_is_noticed_and_ends(pad: TrackedPad) -> None:
    pad.feel(nothing(2.0) + 40.0)
    began = pad.index
    assert pad.feel(palm(1.0) + 40.0, nothing(2.0) + 40.0) == [
        Onset(began),
        Release(began, began + 53, "released"),
    ]


def test_a_firm_finger_on_one_row_is_a_touch(pad: TrackedPad) -> None:
    assert pad.feel(at(nothing(0.5), 4, slice(3, 5), 60.0)) == [Onset(pad.index - 27)]


def test_a_hand_present_at_the_start_counts_as_rest() -> None:
    pad = TrackedPad()
    assert pad.feel(palm(5.0, trembling=False), 1.0) == []
    assert pad.feel(palm(0.2)) == [Onset(pad.index - 11)]


def test_a_hand_moving_at_the_start_is_detected() -> None:
    pad = TrackedPad()
    pad.touched(pat(3.0), 3.0)
    pad.touched(palm(1.0), 2.0)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_an_object_left_on_the_pad_becomes_rest(pad: TrackedPad, noise: float) -> None:
    box = palm(30.0, counts=200.0, trembling=False)
    box *= 1.0 + random(noise, *box.shape)
    began = pad.index
    onset, release = pad.touched(box)
    assert (onset.first_index, release.reason) == (began, "settled")
    assert 10.0 <= (release.last_index - began) / 54 <= 11.0
    # A touch beside the object; then the object is removed.
    beside = box[:54].copy()
    beside[:, 6:8, 0:2] += 30.0
    pad.touched(beside, box[:108])
    assert pad.feel(2.0) == []
    assert pad.feel(palm(0.2, counts=20.0)) == [Onset(pad.index - 11)]


def test_a_gap_ends_the_touch_and_begins_another(pad: TrackedPad) -> None:
    began = pad.index
    pad.feel(palm(1.0))
    pad.gap_ms += 500.0
    release, onset = pad.feel(palm(1.0), restarted=True)
    assert release == Release(began, began + 53, "gap")
    assert onset == Onset(began + 54)


def test_rest_is_calibrated_again_after_a_long_silence(pad: TrackedPad) -> None:
    for gap_ms in (60_000.0, -100_000.0):
        pad.gap_ms += gap_ms
        pad.rest = pad.rest[::-1] + 7
        assert pad.feel(np.zeros((54, 8, 8), np.float32), restarted=True) == []
        assert pad.feel(palm(0.2)) == [Onset(pad.index - 11)]
        pad.feel(2.0)


def test_a_lost_sensor_ends_touch_and_rest(pad: TrackedPad) -> None:
    began = pad.index
    pad.feel(palm(1.0))
    assert pad.tracker.forget("sensor") == Release(began, began + 53, "sensor")
    assert pad.tracker.forget("sensor") is None
    pad.rest += 20
    assert pad.feel(2.0) == []


def with_noise(scans: Scans, deviation: float = 1.2) -> Scans:
    return scans + np.random.default_rng(8).normal(0, deviation, scans.shape).astype(np.float32)


def vibration(hz: float) -> Callable[[Scans], Scans]:
    """Return a function that adds a vibration of two counts; sampled at 54 Hz, a negative one rises first."""

    def with_vibration(scans: Scans) -> Scans:
        wave = 2 * np.sin(2 * np.pi * hz * np.arange(len(scans)) / 54)
        return scans + wave[:, None, None].astype(np.float32)

    return with_vibration


HUM, HUM_UPWARDS, MOTOR = vibration(50), vibration(-50), vibration(23)


def unchanged(scans: Scans) -> Scans:
    return scans


@pytest.mark.parametrize("disturbed", [unchanged, with_noise, HUM, MOTOR])
def test_a_touch_ends_despite_shifted_rest_or_noise(
    pad: TrackedPad, disturbed: Callable[[Scans], Scans]
) -> None:
    pad.feel(disturbed(np.concatenate([pat(4.0), fold(0.1)])))
    left = pad.index
    (release,) = pad.feel(disturbed(fold(2.0)))
    assert (type(release), release.reason) == (Release, "released")
    assert abs(release.last_index - left) <= 54
    # The current reading is the new rest, on which the next touch is detected.
    assert pad.feel(disturbed(fold(5.0))) == []
    assert isinstance(pad.feel(disturbed(fold(0.2) + palm(0.2, counts=40.0)))[0], Onset)


def test_a_light_touch_that_leaves_a_fold_is_dated_by_the_hand(pad: TrackedPad) -> None:
    pad.feel(palm(3.0, counts=10.0))
    left = pad.index
    (release,) = pad.feel(fold(4.0))
    assert abs(release.last_index - left) <= 27


def residue(seconds: float, counts: float) -> Scans:
    """What a hug leaves on a soft pad: a tenth of it, which creeps back slowly."""
    frames = np.arange(round(54 * seconds), dtype=np.float32)
    return palm(seconds, counts, trembling=False) * np.exp(-frames / 200)[:, None, None]


def test_hugs_that_leave_a_residue_stay_separate(pad: TrackedPad) -> None:
    for _ in range(5):
        began = pad.index
        onset, release = pad.touched(palm(2.0, counts=300.0), residue(2.0, 60.0))
        assert abs(onset.first_index - began) <= 2
        assert abs(release.last_index - onset.first_index - 108) <= 9


def test_a_slow_press_is_a_touch(pad: TrackedPad) -> None:
    rising = np.linspace(0, 150, 8 * 54, dtype=np.float32)[:, None, None]
    pad.touched(at(nothing(8.0), slice(2, 5), slice(3, 6), rising), 2.0)


def test_light_touches_after_a_slow_hug_are_detected(pad: TrackedPad) -> None:
    leaving = np.linspace(200, 0, 4 * 54, dtype=np.float32)[:, None, None]
    pad.touched(palm(2.0, counts=200.0), at(nothing(4.0), slice(2, 5), slice(3, 6), leaving), 3.0)
    pad.touched(palm(1.0), 2.0)


def test_a_hand_that_comes_slowly_does_not_hide_the_next_touch(pad: TrackedPad) -> None:
    rising = np.linspace(0, 12, 72, dtype=np.float32)[:, None, None]
    pad.touched(at(nothing(72 / 54), slice(2, 5), slice(3, 6), rising), 1.2)
    began = pad.index
    assert isinstance(light := pad.feel(palm(0.8, counts=4.0))[0], Onset)
    assert abs(light.first_index - began) <= 5


def test_a_leaving_hand_is_not_learned_as_noise(pad: TrackedPad) -> None:
    pad.touched(palm(1.0, counts=200.0), 3.0)
    assert pad.tracker.baseline.noise_floor.mean() < 1.8


def test_a_slow_wide_press_is_not_learned_as_noise(pad: TrackedPad) -> None:
    away = np.hypot(*np.mgrid[-3.5:4, -3.5:4]) / 3.5
    rising = np.linspace(0, 15, 108, dtype=np.float32)[:, None, None]
    pad.feel(rising * np.exp(-0.5 * away**2).astype(np.float32))
    assert pad.tracker.baseline.noise_floor.mean() < 1.8


def test_presses_that_shift_the_rest_stay_separate(pad: TrackedPad) -> None:
    for press in range(8):
        pad.touched(fold(1.5, 5.0 * press) + pat(1.5, counts=120.0), fold(3.0, 5.0 * (press + 1)))


def test_a_touch_ends_when_only_the_object_remains(pad: TrackedPad) -> None:
    box = palm(2.0, counts=30.0, trembling=False)
    pad.touched(palm(3.0, counts=150.0), box)
    # Movement below the hand does not make the other taxels less sensitive.
    began, beside = pad.index, box[:54].copy()
    beside[:, 6:8, 0:3] += 16.0
    assert pad.feel(beside) == [Onset(began)]


def test_started_under_a_hand_it_recovers_within_2_s() -> None:
    pad = TrackedPad()
    pad.feel(palm(4.0, counts=60.0), 2.0)
    assert pad.feel(1.0) == []
    assert pad.feel(palm(0.2, counts=20.0)) == [Onset(pad.index - 11)]


def test_no_touch_lasts_longer_than_ten_minutes(pad: TrackedPad) -> None:
    onset, *others = pad.feel(palm(5.0, counts=60.0))
    # Frames are counted by their index; all of them would take seconds.
    pad.index += 590 * 54
    release, *_ = pad.feel(palm(10.0, counts=60.0))
    assert (type(onset), others, release.reason) == (Onset, [], "longest")
    assert (release.last_index - release.first_index) / 54 == pytest.approx(600.0, abs=0.1)


def faint(seconds: float) -> Scans:
    """A hand whose pressure is below the noise in every taxel."""
    return nothing(seconds) + np.float32(0.5)


def breath(seconds: float, counts: float = 3.0) -> Scans:
    """The body below breathes at 0.5 Hz."""
    depth = counts / 2 * (1 - np.cos(2 * np.pi * 0.5 * np.arange(round(54 * seconds)) / 54))
    return (depth[:, None, None] * np.ones((8, 8))).astype(np.float32)


class Network:
    """Answers with `no_touch`; windows: the lengths of the windows it was asked about."""

    def __init__(self) -> None:
        self.no_touch = 0.9
        self.windows: list[int] = []

    def __call__(self, window: NDArray[np.float32]) -> float:
        self.windows.append(len(window))
        return self.no_touch


@pytest.fixture
def network() -> Network:
    return Network()


@pytest.fixture
def seen(network: Network) -> TrackedPad:
    """A pad whose rest the network has seen."""
    pad = TrackedPad(p_no_touch=network)
    assert pad.feel(2.0) == []
    return pad


def test_the_network_ends_a_false_touch(seen: TrackedPad) -> None:
    onset, *_ = seen.feel(palm(1.0, counts=150.0) + breath(1.0))
    left = seen.index
    (release,) = seen.feel(breath(2.0, counts=6.0))
    assert (type(onset), type(release)) == (Onset, Release)
    assert release.last_index - left <= 54


def test_the_network_ends_a_touch_on_a_pad_that_drifts(seen: TrackedPad, network: Network) -> None:
    scans = np.concatenate([pat(3.0), breath(2.0, counts=6.0)])
    scans += 4.0 * (np.arange(len(scans), dtype=np.float32) / 54)[:, None, None]
    network.no_touch = 0.02
    (onset,) = seen.feel(scans[: 3 * 54])
    network.no_touch = 0.9
    (release, *_) = seen.feel(scans[3 * 54 :])
    assert isinstance(onset, Onset)
    assert release.reason == "released"


def test_the_network_is_asked_between_contacts_too(seen: TrackedPad, network: Network) -> None:
    network.no_touch = 0.02
    seen.feel(pat(3.0))
    network.windows.clear()
    assert seen.feel(nothing(0.7)) == []
    assert network.windows.count(54) >= 2


def test_a_touch_that_only_the_network_sees_is_detected(seen: TrackedPad, network: Network) -> None:
    began = seen.index
    network.no_touch = 0.02
    (onset,) = seen.feel(faint(1.5))
    assert abs(onset.first_index - began) <= 27
    network.no_touch = 0.9
    (release,) = seen.feel(2.0)
    assert isinstance(release, Release)


def test_a_hand_that_leaves_slowly_hides_the_next_only_briefly(seen: TrackedPad, network: Network) -> None:
    network.no_touch = 0.02
    assert isinstance(seen.feel(palm(1.0))[0], Onset)
    network.no_touch = 0.9
    assert isinstance(seen.feel(1.2)[0], Release)
    leaving = palm(24 / 54, 6.0, trembling=False) * np.sin(np.pi * np.arange(24) / 24)[:, None, None]
    assert seen.feel(leaving.astype(np.float32), 3.2) == []
    # Between the network's limits for a pad at rest and for contact that moves.
    network.no_touch = 0.4
    assert isinstance(seen.feel(palm(0.8, 5.5))[0], Onset)


def test_above_the_default_threshold_the_network_alone_begins_no_touch(network: Network) -> None:
    pad = TrackedPad(TouchSettings(onset_threshold=20.0), network)
    assert pad.feel(2.0) == []
    network.no_touch = 0.02
    assert pad.feel(faint(1.5)) == []


def test_a_hand_below_the_default_threshold_keeps_its_touch() -> None:
    pad = TrackedPad(TouchSettings(onset_threshold=1.0))
    assert pad.feel(2.0) == []
    noise_floor = float(pad.tracker.baseline.noise_floor.max())
    swell = np.where(np.arange(4 * 54) % 54 < 27, 1.0, 3.0)
    onset, release = pad.touched(
        at(nothing(1.0), 4, 3, 40.0), at(nothing(4.0), 4, 3, noise_floor + swell), 2.0
    )
    assert (release.last_index - onset.first_index) / 54 > 4.5


@pytest.mark.parametrize("hand", [palm(1.0, counts=60.0), palm(3.0, counts=300.0)])
def test_an_object_that_looks_like_a_hand_becomes_rest(
    seen: TrackedPad, network: Network, hand: Scans
) -> None:
    network.no_touch = 0.02
    seen.touched(hand, palm(60.0, counts=60.0, trembling=False))
    network.no_touch = 0.9
    assert seen.feel(5.0) == []
    network.no_touch = 0.02
    assert [type(change) for change in seen.feel(faint(1.5))] == [Onset]


def test_a_single_answer_of_the_network_makes_no_touch(seen: TrackedPad, network: Network) -> None:
    for _ in range(5):
        network.no_touch = 0.02
        assert seen.feel(faint(1 / 3)) == []
        network.no_touch = 0.9
        assert seen.feel(nothing(1.0)) == []


def test_a_network_that_sees_touches_at_rest_is_ignored(network: Network) -> None:
    network.no_touch = 0.02
    pad = TrackedPad(p_no_touch=network)
    assert pad.feel(20.0) == []
    pad.touched(palm(1.0, counts=80.0), 2.0)


def test_the_network_forgets_a_pad_with_its_sensor(seen: TrackedPad, network: Network) -> None:
    seen.feel(8.0)
    seen.tracker.forget("sensor")
    # Another pad, which the network does not know at rest.
    network.no_touch = 0.02
    assert seen.feel(nothing(10.0) + 20.0, restarted=True) == []


def test_a_light_still_hand_is_detected_after_a_second(seen: TrackedPad, network: Network) -> None:
    # Not low enough for the network's checks alone to begin a touch.
    network.no_touch = 0.25
    began = seen.index
    (onset,) = seen.feel(palm(1.2, counts=6.0, trembling=False))
    assert abs(onset.first_index - began) <= 1


def test_a_pause_does_not_split_a_touch_the_network_sees(seen: TrackedPad, network: Network) -> None:
    network.no_touch = 0.02
    changes = seen.feel(pat(2.0), nothing(1.8), pat(2.0))
    network.no_touch = 0.9
    assert [type(change) for change in [*changes, *seen.feel(2.0)]] == [Onset, Release]


# The pad is jolted: three rows rise for less than half a second.
JOLT = np.concatenate([at(nothing(0.4), slice(3, 6), slice(8), 3.0), nothing(0.6)])


def test_a_jolt_like_one_that_was_no_touch_begins_none(network: Network) -> None:
    pad = TrackedPad(TouchSettings(onset_threshold=5.0), network)
    assert pad.feel(5.0, JOLT) == []
    network.no_touch = 0.02
    assert pad.feel(JOLT, 2.0) == []


def test_a_jolted_pad_does_not_prolong_a_touch(seen: TrackedPad) -> None:
    assert seen.feel(3.0, JOLT) == []
    seen.feel(palm(1.0, counts=20.0))
    left = seen.index
    (release,) = seen.feel(0.4, palm(0.4, counts=3.0, trembling=False), 1.0)
    assert release.last_index == left - 1


def test_slow_movement_of_a_body_begins_no_touch(seen: TrackedPad) -> None:
    assert seen.feel(breath(20.0, counts=2.3)) == []


@pytest.mark.parametrize("lift_counts", [5.0, 20.0, 100.0])
def test_an_even_rise_of_all_taxels_begins_no_touch(classifier: Classifier, lift_counts: float) -> None:
    def no_touch(window: NDArray[np.float32]) -> float:
        seen = as_known(window, pad.tracker.baseline.counts)
        return float(classifier.probabilities(seen)[classifier.labels.index("notouch")])

    pad = TrackedPad(p_no_touch=no_touch)
    assert pad.feel(3.0, nothing(8.0) + lift_counts) == []
    assert pad.feel(palm(0.5, 60.0) + lift_counts) == [Onset(pad.index - 27)]


def test_light_contact_needs_the_network_to_see_a_touch() -> None:
    wobble = palm(10.0, counts=5.0, trembling=False)
    wobble *= 1 + 0.5 * np.sin(np.arange(len(wobble)) / 10)[:, None, None].astype(np.float32)
    sees_none = TrackedPad(p_no_touch=lambda window: 0.9)
    assert sees_none.feel(2.0, wobble) == []
    sees_one = TrackedPad(p_no_touch=lambda window: 0.1)
    assert isinstance(sees_one.feel(2.0, wobble)[0], Onset)


@pytest.mark.parametrize("vibrating", [HUM, HUM_UPWARDS, MOTOR])
@pytest.mark.parametrize("still_s", [1.0, 1.1])
def test_the_start_of_a_vibration_begins_no_touch(
    pad: TrackedPad, vibrating: Callable[[Scans], Scans], still_s: float
) -> None:
    assert pad.feel(still_s, vibrating(nothing(10.0))) == []
    assert isinstance(pad.feel(vibrating(palm(0.5, counts=40.0)))[0], Onset)


@pytest.mark.parametrize("vibrating", [HUM, HUM_UPWARDS])
def test_a_taxel_that_vibrates_more_begins_no_touch(vibrating: Callable[[Scans], Scans]) -> None:
    scans = vibrating(nothing(4.0))
    scans[:, 0, 0] *= 4.5
    assert TrackedPad(p_no_touch=lambda window: 0.9).feel(2.0, scans) == []


def test_a_pad_is_disturbed_while_it_is_noisy(pad: TrackedPad) -> None:
    assert not pad.tracker.baseline.is_disturbed
    pad.feel(with_noise(nothing(10.0), 2.0))
    assert pad.tracker.baseline.is_disturbed
    pad.feel(20.0)
    assert not pad.tracker.baseline.is_disturbed


def known(rest: float = 10.0) -> Baseline:
    baseline = Baseline()
    baseline.calibrate(np.full((27, 64), rest, np.float32))
    return baseline


@pytest.mark.parametrize(("read", "moved"), [(20.0, 1 / 3), (0.0, -1 / 3)], ids=["contact", "dip"])
def test_light_contact_of_a_second_hardly_moves_the_rest(read: float, moved: float) -> None:
    baseline = known()
    for _ in range(54):
        baseline.track(np.full(64, read, np.float32))
    np.testing.assert_allclose(baseline.counts, 10.0 + moved, atol=0.02)


def test_the_rest_follows_a_slow_drift() -> None:
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
    assert not baseline.is_disturbed


def test_the_last_second_is_split_older_half_first() -> None:
    recent = LastSecond()
    for read in range(60):
        recent.push(np.full(64, read, np.float32))
    assert [half.mean() for half in recent.halves()] == [19.0, 46.0]


JUMPS = np.array([5, 4, 12, 9, 2, 2, 4, 6], np.float32)


def loose(seconds: float) -> Scans:
    """A loose wire, moved by a breathing body, raises a column for half of every second."""
    scans = nothing(seconds)
    up = np.arange(len(scans)) % 54 >= 27
    scans[:, :, 5] = up[:, None] * JUMPS
    return scans


def test_a_loose_wire_is_found_without_a_touch() -> None:
    pad = TrackedPad()
    assert pad.feel(2.0, loose(3.0)) == []
    assert pad.tracker.loose_lines == ("column 6",)
    assert pad.feel(loose(60.0)) == []


@pytest.mark.parametrize("hand", [palm(3.0), pat(3.0)], ids=["palm", "pat"])
def test_touches_begin_and_end_despite_a_loose_wire(hand: Scans) -> None:
    pad = TrackedPad()
    pad.feel(2.0, loose(6.0))
    for _ in range(4):
        pad.touched(hand + loose(3.0), loose(3.0))


def test_the_network_does_not_see_a_loose_wires_jumps() -> None:
    pad = TrackedPad()
    pad.feel(2.0, loose(6.0))
    jumping = loose(2.0) + pad.rest.astype(np.float32)
    assert np.ptp(jumping, axis=0).max() == 12.0
    assert np.ptp(pad.tracker.without_loose_wire(jumping), axis=0).max() < 3.0


def strokes_on_a_row(seconds: float) -> Scans:
    scans = nothing(seconds)
    scans[:, 3] = 5.0 * np.maximum(np.sin(np.arange(len(scans)) * 2 * np.pi / 108), 0)[:, None]
    return scans


@pytest.mark.parametrize(
    "scans",
    [nothing(10.0), fold(10.0), drift(0.5), pat(10.0), strokes_on_a_row(10.0)],
    ids=["nothing", "fold", "drift", "pat", "strokes on a row"],
)
def test_a_slow_or_lasting_step_is_not_a_loose_wire(pad: TrackedPad, scans: Scans) -> None:
    pad.feel(scans, 3.0)
    assert pad.tracker.loose_lines == ()
    assert pad.tracker.without_loose_wire(scans) is scans


def test_a_loose_wire_is_forgotten_with_the_sensor(pad: TrackedPad) -> None:
    pad.feel(loose(6.0))
    pad.tracker.forget("sensor")
    assert pad.tracker.loose_lines == ()


def sees_what_varies(window: NDArray[np.float32]) -> float:
    """A network that takes a pad whose mean varied for a touch."""
    return 0.02 if np.ptp(window.mean(axis=(1, 2))) > 2.0 else 0.9


def test_a_light_tap_of_the_whole_hand_is_a_touch_once_it_has_gone() -> None:
    pad = TrackedPad(p_no_touch=sees_what_varies)
    pad.feel(3.0)
    began = pad.index
    tap = np.full((6, 8, 8), 4.0, np.float32)
    onset, release = pad.touched(tap, 2.0)
    assert abs(onset.first_index - began) <= 2
    assert abs(release.last_index - (began + 5)) <= 2


def test_a_light_tap_is_felt_although_hands_have_hardly_left_the_pad_since_the_start() -> None:
    pad = TrackedPad(p_no_touch=sees_what_varies)
    pad.feel(0.6)
    for _ in range(3):
        pad.touched(palm(0.5), 1.6)
    began = pad.index
    onset, _ = pad.touched(np.full((6, 8, 8), 4.0, np.float32), 2.0)
    assert abs(onset.first_index - began) <= 2


def test_a_wobble_that_the_network_takes_for_none_is_no_touch() -> None:
    pad = TrackedPad(p_no_touch=lambda window: 0.9)
    assert pad.feel(3.0, np.full((6, 8, 8), 4.0, np.float32), 2.0) == []
