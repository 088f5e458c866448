"""When a touch begins and ends, on a made pad with HAART's noise."""

from collections.abc import Callable

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


class TrackedPad(MadePad):
    """A made pad that feeds a tracker. p_no_touch: asked instead of the shipped classifier."""

    def __init__(
        self,
        settings: TouchSettings | None = None,
        p_no_touch: Callable[[Scans], float] | None = None,
        detector: Detector | None = None,
        *,
        is_finer: bool = False,
    ) -> None:
        super().__init__()
        found_by = PipelineSettings(touch=settings or TouchSettings(), is_finer=is_finer)
        detector = detector or Detector.load()
        self.tracker = tracker_of(found_by, Classifier.load(), detector)
        if p_no_touch is not None:
            question = lambda frames, rest: p_no_touch(frames)  # noqa: E731
            self.tracker = TouchTracker(found_by.touch, detector, question, is_finer=is_finer)
        self.index = 0
        self.gap_ms = 0.0

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

    def touched(self, *pressures: Scans | float) -> tuple[Onset, Release]:
        """Feed pressure that must be exactly one touch; return its beginning and end."""
        onset, release = self.feel(*pressures)
        assert (type(onset), type(release)) == (Onset, Release)
        return onset, release


@pytest.fixture
def pad() -> TrackedPad:
    pad = TrackedPad()
    assert pad.feel(3.0) == []
    return pad


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
    changes = pad.feel(*scans)
    assert [type(change) for change in changes] == [Onset, Release] * touches
    assert {change.reason for change in changes if isinstance(change, Release)} == {"released"}


@pytest.mark.parametrize(("counts", "within_frames"), [(60.0, 3), (12.0, 6)])
def test_a_touch_is_found_soon_and_dated_to_its_first_frame(
    pad: TrackedPad, counts: float, within_frames: int
) -> None:
    began = pad.index
    while not (changes := pad.feel(palm(1 / 54, counts))):
        assert pad.index - began < within_frames
    assert changes == [Onset(changes[0].first_index)]
    assert abs(changes[0].first_index - began) <= 1


@pytest.mark.parametrize("quiet_s", [0.1, 0.4, 0.8, 2.0])
def test_a_touch_ends_after_its_quiet_time_at_its_last_contact(quiet_s: float) -> None:
    pad = TrackedPad(TouchSettings(quiet_s=quiet_s))
    pad.feel(3.0, palm(2.0, 60.0))
    left = pad.index
    while not (changes := pad.feel(1 / 54)):
        assert pad.index - left < 54 * (quiet_s + 0.3)
    (release,) = changes
    assert isinstance(release, Release)
    assert abs(pad.index - left - 54 * quiet_s) <= 9
    assert abs(release.last_index - left) <= 9


def test_a_finer_pads_residue_ends_a_touch_though_it_looks_like_a_hand() -> None:
    pad = TrackedPad(p_no_touch=lambda frames: 0.0, is_finer=True)
    pad.feel(3.0)
    changes = pad.feel(*[palm(2.0, 300.0), fading(2.5, 3.7)] * 5)
    assert [type(change) for change in changes] == [Onset, Release] * 5


def test_a_more_sensitive_tracker_finds_more_light_touches() -> None:
    taps = [part for counts in np.arange(1.0, 5.0, 0.2) for part in (palm(0.5, counts, False), 2.0)]
    found = {}
    for sensitivity in ("high", "low"):
        pad = TrackedPad(TouchSettings(sensitivity=sensitivity))
        found[sensitivity] = sum(isinstance(change, Onset) for change in pad.feel(3.0, *taps))
    assert found["high"] > found["low"] > 0


def test_an_object_left_on_the_pad_becomes_rest(pad: TrackedPad) -> None:
    box = palm(15.0, 30.0, trembling=False)
    onset, release = pad.feel(box)
    assert isinstance(onset, Onset)
    assert isinstance(release, Release)
    assert release.reason == "settled"
    assert pad.feel(box) == []
    pad.touched(box[:54] + cells(1.0, slice(6, 8), slice(0, 3), 40.0), box[:108])


def test_no_touch_lasts_longer_than_ten_minutes(pad: TrackedPad, monkeypatch: pytest.MonkeyPatch) -> None:
    assert tracker.LONGEST_FRAMES == 600 * 54
    monkeypatch.setattr(tracker, "LONGEST_FRAMES", 20 * 54)
    changes: list[Onset | Release] = []
    while len(changes) < 2:
        changes += pad.feel(palm(8.0, 60.0))
        assert pad.index < 54 * 40
    assert isinstance(changes[1], Release)
    assert changes[1].reason == "longest"


def test_a_hand_at_the_start_counts_as_rest_until_it_leaves() -> None:
    pad = TrackedPad()
    assert not pad.feel(palm(2.0, 30.0, trembling=False))
    pad.feel(3.0)
    pad.touched(palm(1.0, 60.0), 2.0)


def test_a_gap_ends_the_touch_and_begins_another(pad: TrackedPad) -> None:
    pad.feel(palm(1.0, 60.0))
    pad.gap_ms = 500.0
    release, onset = pad.feel(palm(1.0, 60.0), restarted=True)
    assert isinstance(release, Release)
    assert release.reason == "gap"
    assert isinstance(onset, Onset)


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


def test_a_hand_that_presses_again_lightly_goes_on_on_a_finer_pad() -> None:
    pad = TrackedPad(is_finer=True)
    pad.feel(3.0)
    assert [type(change) for change in pad.feel(palm(2.0, 300.0), pat(3.0, 100.0))] == [Onset]


def test_a_low_load_that_keeps_still_ends_a_touch_though_it_looks_like_a_hand() -> None:
    pad = TrackedPad(p_no_touch=lambda frames: 0.0)
    pad.feel(3.0)
    pad.touched(palm(2.0, 300.0), palm(3.0, 60.0, trembling=False))


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


@pytest.mark.parametrize(("p_no_touch", "touches"), [(0.1, 1), (0.9, 0)])
def test_a_likely_hand_is_a_touch_within_a_quarter_second_if_the_classifier_agrees(
    p_no_touch: float, touches: int
) -> None:
    pad = TrackedPad(None, lambda frames: p_no_touch, unsure(0.9, 0.9))
    pad.feel(3.0)
    assert len(pad.feel(palm(0.25, 60.0))) == touches


@pytest.mark.parametrize(("question", "touches"), [(lambda frames, rest: 0.1, 1), (None, 0)])
def test_a_likely_hand_that_left_begins_a_touch_only_if_the_classifier_confirms_it(
    question: Question | None, touches: int
) -> None:
    pad = TrackedPad()
    pad.tracker = TouchTracker(TouchSettings(), unsure(0.9, 0.9), question)
    assert len(pad.feel(3.0, palm(1 / 54, 60.0), 0.3)) == touches


def test_the_classifier_ends_a_touch_that_is_doubtful_for_as_long_as_quiet() -> None:
    asked: list[int] = []

    def sees_nobody(frames: Scans) -> float:
        asked.append(len(frames))
        return 0.9

    pad = TrackedPad(None, sees_nobody, unsure(1.0, 0.5))
    pad.feel(3.0)
    onset, release, *_ = pad.feel(palm(2.0, 60.0))
    assert (type(onset), type(release)) == (Onset, Release)
    assert set(asked) == {43}


def test_a_pad_is_untouched_two_seconds_after_the_last_hand(pad: TrackedPad) -> None:
    pad.touched(palm(1.0, 60.0), 2.0)
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
