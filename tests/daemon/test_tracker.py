"""When a touch begins and ends, on a made pad with HAART's noise."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.made_pad import MadePad, Scans, nothing, palm, pat

from touchd.daemon.path import tracker
from touchd.daemon.path.pipeline import PipelineSettings, tracker_of
from touchd.daemon.path.tracker import Onset, Question, Release, TouchSettings, TouchTracker
from touchd.drivers.pad.grid import GridFrame
from touchd.model.classifier import Classifier
from touchd.model.detector import Detector, DetectorState

AT_S = np.arange(30 * 54, dtype=np.float32)[:, None, None] / 54
NOISE = np.random.default_rng(6).normal(0.0, 1.0, (20 * 54, 8, 8)).astype(np.float32)


def cells(seconds: float, row: int | slice, column: int | slice, counts: object) -> Scans:
    scans = nothing(seconds)
    scans[:, row, column] = counts
    return scans


def fold(seconds: float, counts: float = 4.0) -> Scans:
    """A fold that a touch left: a third of the pad reads higher, without moving."""
    return cells(seconds, slice(8), slice(2, 5), counts)


def fading(seconds: float, time_constant_s: float) -> Scans:
    """What a hand leaves on a soft pad, which creeps back."""
    return palm(seconds, 60.0, trembling=False) * np.exp(-AT_S[: round(54 * seconds)] / time_constant_s)


def shaken(hz: float, counts: float = 2.0) -> Scans:
    return nothing(20.0) + counts * np.sin(2 * np.pi * hz * AT_S[: 20 * 54])


def ramp(first: float, last: float, seconds: float) -> Scans:
    rising = np.linspace(first, last, round(54 * seconds), dtype=np.float32)[:, None, None]
    return cells(seconds, slice(2, 5), slice(3, 6), rising)


def shipped(**settings: Any) -> TouchTracker:
    """A tracker with the shipped networks."""
    found_by = PipelineSettings(touch=TouchSettings(**settings))
    return tracker_of(found_by, Classifier.load(), Detector.load())


class TrackedPad(MadePad):
    """A made pad that feeds a tracker, and has been at rest for three seconds."""

    def __init__(self, tracker: TouchTracker | None = None) -> None:
        super().__init__()
        self.tracker = tracker or shipped()
        self.index = 0
        self.gap_ms = 0.0
        assert self.feel(3.0) == []

    def feel(self, *pressures: Scans | float, restarted: bool = False) -> list[Onset | Release]:
        """Feed scans (T, 8, 8), or seconds of nothing; return the tracker's changes."""
        changes = []
        for pressure in pressures:
            scans = nothing(pressure) if isinstance(pressure, float) else pressure
            for counts in self.counts(scans).astype("float32"):
                sensor_ms = self.index * 1000 / 54 + self.gap_ms
                change = self.tracker.update(GridFrame(self.index, sensor_ms, 0.0, counts, False, restarted))
                changes += [change] if change else []
                self.index += 1
                restarted = False
        return changes

    def story(self, *pressures: Scans | float, restarted: bool = False) -> list[str]:
        """Feed the same; return that a touch began, or why it ended."""
        changes = self.feel(*pressures, restarted=restarted)
        return [change.reason if isinstance(change, Release) else "began" for change in changes]


@pytest.fixture
def pad() -> TrackedPad:
    return TrackedPad()


TOUCH = ["began", "released"]
BLOW = cells(4 / 54, slice(8), slice(8), 600.0)
WIRE = cells(0.5, 4, slice(8), [1.6, 1.5, 1.9, 2.5, 4.5, 3.3, 3.4, 3.8])


@pytest.mark.parametrize(
    "scans",
    [
        pytest.param([30.0], id="rest"),
        pytest.param([WIRE, 1.0, WIRE, 1.0, WIRE, 1.0], id="loose wire"),
        pytest.param([400.0 * np.abs(NOISE[:1]), 1.0], id="broken scan"),
        pytest.param([cells(10.0, 1, 1, 6.0 * NOISE[:540, 0, 0])], id="jittery taxel"),
        pytest.param([nothing(30.0) + 0.2 * AT_S], id="slow drift"),
        pytest.param([nothing(10.0) + 10.0, 10.0], id="supply step"),
        pytest.param([1.5 * NOISE], id="noise"),
        pytest.param([shaken(50.0)], id="mains hum"),
        pytest.param([shaken(23.0)], id="motor"),
        pytest.param([shaken(0.4, 4.0)], id="breathing body"),
    ],
)
def test_a_pad_that_nobody_touches_reports_no_touch(pad: TrackedPad, scans: list[Scans | float]) -> None:
    assert pad.feel(*scans) == []


@pytest.mark.parametrize(
    ("scans", "touches"),
    [
        pytest.param([palm(2.0, 60.0), 2.0], 1, id="firm hand"),
        pytest.param([palm(2.0), 2.0], 1, id="light hand"),
        pytest.param([palm(30.0, 40.0), 2.0], 1, id="long hand"),
        pytest.param([pat(3.0), 2.0], 1, id="pats"),
        pytest.param([palm(1.0, 60.0), 0.5, palm(1.0, 60.0), 2.0], 1, id="a short pause"),
        pytest.param([palm(1.0, 60.0), 1.5, palm(1.0, 60.0), 2.0], 2, id="two hands"),
        pytest.param([ramp(0.0, 150.0, 8.0), 2.0], 1, id="slow press"),
        pytest.param([palm(2.0, 200.0), ramp(200.0, 0.0, 3.0), 2.0, palm(1.0), 2.0], 2, id="slow release"),
        pytest.param(
            [pat(2.0, 120.0), fold(3.0, 1.5), fold(1.5, 1.5) + pat(1.5, 120.0), fold(3.0, 3.0)], 2, id="folds"
        ),
        pytest.param([shaken(50.0)[:54] + palm(1.0, 60.0), shaken(50.0)[:162]], 1, id="a hand in hum"),
        pytest.param([BLOW, 2.0], 1, id="a blow"),
        pytest.param([palm(1.0, 60.0), fading(9.0, 5.0), 3.0], 1, id="a still load that slowly fades"),
    ],
)
def test_touches_are_counted(pad: TrackedPad, scans: list[Scans | float], touches: int) -> None:
    assert pad.story(*scans) == TOUCH * touches


@pytest.mark.parametrize(("counts", "within_frames"), [(60.0, 3), (12.0, 6)])
def test_a_touch_is_found_soon_and_dated_to_its_beginning(
    pad: TrackedPad, counts: float, within_frames: int
) -> None:
    began = pad.index
    while not (changes := pad.feel(palm(1 / 54, counts))):
        assert pad.index - began < within_frames
    assert changes == [Onset(changes[0].first_index)]
    assert abs(changes[0].first_index - began) <= 1


@pytest.mark.parametrize("quiet_s", [0.1, 0.4, 0.8, 2.0])
def test_a_touch_ends_quiet_s_after_its_last_contact(quiet_s: float) -> None:
    pad = TrackedPad(shipped(quiet_s=quiet_s))
    pad.feel(palm(2.0, 60.0))
    left = pad.index
    while not (changes := pad.feel(1 / 54)):
        assert pad.index - left < 54 * (quiet_s + 0.3)
    (release,) = changes
    assert isinstance(release, Release)
    assert abs(pad.index - left - 54 * quiet_s) <= 9
    assert abs(release.last_index - left) <= 9


def sees_a_hand(frames: Scans, rest: NDArray[np.float32]) -> float:
    return 0.0


@pytest.mark.parametrize(
    ("is_finer", "scans", "story"),
    [
        pytest.param(True, [palm(2.0, 300.0), fading(2.5, 3.7)] * 5, TOUCH * 5, id="a finer pad's residue"),
        pytest.param(True, [palm(2.0, 300.0), pat(3.0, 100.0)], ["began"], id="a hand, now lighter"),
        pytest.param(False, [palm(2.0, 300.0), palm(3.0, 60.0, False)], TOUCH, id="a low load, still"),
    ],
)
def test_what_a_hand_left_ends_a_touch(is_finer: bool, scans: list[Scans], story: list[str]) -> None:
    pad = TrackedPad(TouchTracker(TouchSettings(), Detector.load(), sees_a_hand, is_finer=is_finer))
    assert pad.story(*scans) == story


def test_a_more_sensitive_tracker_finds_more_light_touches() -> None:
    taps = [part for counts in np.arange(1.0, 5.0, 0.2) for part in (palm(0.5, counts, False), 2.0)]
    found = {}
    for sensitivity in ("high", "low"):
        found[sensitivity] = TrackedPad(shipped(sensitivity=sensitivity)).story(*taps).count("began")
    assert found["high"] > found["low"] > 0


def test_an_object_left_on_the_pad_becomes_rest(pad: TrackedPad) -> None:
    box = palm(15.0, 30.0, trembling=False)
    assert pad.story(box) == ["began", "settled"]
    assert pad.story(box) == []
    assert pad.story(box[:54] + cells(1.0, slice(6, 8), slice(0, 3), 40.0), box[:108]) == TOUCH


def test_no_touch_lasts_longer_than_ten_minutes(pad: TrackedPad, monkeypatch: pytest.MonkeyPatch) -> None:
    assert tracker.LONGEST_FRAMES == 600 * 54
    monkeypatch.setattr(tracker, "LONGEST_FRAMES", 20 * 54)
    assert pad.story(palm(19.5, 60.0)) == ["began"]
    assert pad.story(palm(1.0, 60.0))[:1] == ["longest"]


def test_a_hand_at_the_start_is_rest_until_it_leaves(pad: TrackedPad) -> None:
    pad.tracker.forget("sensor")
    assert pad.story(palm(2.0, 30.0, trembling=False)) == []
    pad.feel(3.0)
    assert pad.story(palm(1.0, 60.0), 2.0) == TOUCH


def test_a_gap_ends_the_touch_and_begins_another(pad: TrackedPad) -> None:
    pad.feel(palm(1.0, 60.0))
    pad.gap_ms = 500.0
    assert pad.story(palm(1.0, 60.0), restarted=True) == ["gap", "began"]


@pytest.mark.parametrize("frames", [1, 3, 5])
def test_a_touch_that_a_gap_interrupts_begins_after_it(pad: TrackedPad, frames: int) -> None:
    assert pad.feel(palm(frames / 54, 3.0, trembling=False)) == []
    after_gap, pad.gap_ms = pad.index, 500.0
    (onset,) = pad.feel(palm(1.0, 3.0, trembling=False), restarted=True)
    assert onset.first_index >= after_gap


@pytest.mark.parametrize("gap_ms", [2100.0, -5000.0])
def test_after_a_long_gap_rest_is_measured_again(pad: TrackedPad, gap_ms: float) -> None:
    pad.gap_ms = gap_ms
    assert pad.feel(palm(3.0, 30.0, trembling=False), restarted=True) == []
    assert pad.tracker.rest.reshape(8, 8)[2:5, 3:6].mean() > 25.0


def test_a_lost_sensor_ends_touch_and_rest(pad: TrackedPad) -> None:
    assert pad.tracker.forget("sensor") is None
    pad.feel(1.0, palm(1.0, 60.0))
    release = pad.tracker.forget("sensor")
    assert release is not None
    assert release.reason == "sensor"
    assert pad.feel(palm(2.0, 60.0, trembling=False)) == []
    assert pad.tracker.rest.reshape(8, 8)[2:5, 3:6].min() > 55.0


def unsure(before: float, during: float) -> Detector:
    """A detector to which a hand is at most so likely, before a touch and during it."""

    class Unsure(Detector):
        def step(
            self, counts: NDArray[np.float32], state: DetectorState, *, is_touch: bool
        ) -> tuple[float, DetectorState]:
            probability, after = super().step(counts, state, is_touch=is_touch)
            return min(probability, during if is_touch else before), after

    real = Detector.load()
    return Unsure(real.session, real.width, real.training)


def test_four_nearly_sure_frames_begin_a_touch() -> None:
    pad = TrackedPad(TouchTracker(TouchSettings(), unsure(0.97, 1.0)))
    assert pad.story(palm(3 / 54, 60.0)) == []
    assert pad.story(palm(1 / 54, 60.0)) == ["began"]


@pytest.mark.parametrize(
    ("p_no_touch", "scans", "touches"),
    [
        pytest.param(0.1, [palm(0.25, 60.0)], 1, id="confirmed"),
        pytest.param(0.9, [palm(0.25, 60.0)], 0, id="refused"),
        pytest.param(0.1, [palm(1 / 54, 60.0), 0.3], 1, id="confirmed, a blow"),
        pytest.param(None, [palm(1 / 54, 60.0), 0.3], 0, id="nobody to ask, a blow"),
    ],
)
def test_a_likely_hand_begins_a_touch_if_the_classifier_agrees(
    p_no_touch: float | None, scans: list[Scans | float], touches: int
) -> None:
    question: Question | None = None if p_no_touch is None else lambda frames, rest: p_no_touch
    pad = TrackedPad(TouchTracker(TouchSettings(), unsure(0.9, 0.9), question))
    began = pad.index
    found = [change.first_index - began for change in pad.feel(*scans) if isinstance(change, Onset)]
    assert found == pytest.approx([0] * touches, abs=1)


@pytest.mark.parametrize(("p_no_touch", "within_s"), [(0.05, 0.12), (0.1, 0.21)])
def test_a_likely_hand_is_found_sooner_the_surer_the_classifier(p_no_touch: float, within_s: float) -> None:
    pad = TrackedPad(TouchTracker(TouchSettings(), unsure(0.9, 0.9), lambda frames, rest: p_no_touch))
    began = pad.index
    while not pad.feel(palm(1 / 54, 60.0)):
        pass
    assert within_s - 0.03 < (pad.index - began) / 54 <= within_s


def test_the_classifier_ends_a_touch_in_doubt_after_quiet_s() -> None:
    asked: list[int] = []

    def sees_nobody(frames: Scans, rest: NDArray[np.float32]) -> float:
        asked.append(len(frames))
        return 0.9

    pad = TrackedPad(TouchTracker(TouchSettings(), unsure(1.0, 0.5), sees_nobody))
    assert pad.story(palm(2.0, 60.0))[:2] == TOUCH
    assert set(asked) == {43}


def test_a_pad_is_untouched_two_seconds_after_the_last_hand(pad: TrackedPad) -> None:
    assert pad.story(palm(1.0, 60.0), 2.0) == TOUCH
    assert not pad.tracker.is_untouched
    pad.feel(1.5)
    assert pad.tracker.is_untouched


def test_rest_follows_the_pad_and_stays_during_a_touch(pad: TrackedPad) -> None:
    pad.feel(nothing(20.0) + 0.2 * AT_S[: 20 * 54])
    level = pad.tracker.rest.reshape(8, 8) - MadePad().rest
    assert level.mean() == pytest.approx(4.0, abs=0.7)
    pad.feel(palm(0.5, 60.0))
    before = pad.tracker.rest.copy()
    pad.feel(palm(2.0, 60.0))
    np.testing.assert_array_equal(pad.tracker.rest, before)
