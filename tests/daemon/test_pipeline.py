"""The pipeline from frames to events: the model's windows, and the answers at each stage."""

import itertools
import logging
from collections.abc import Callable, Sequence
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.audit import Audit
from rigs.expectations import LENGTHS, answers
from rigs.made_pad import MadePad, Scans, nothing, palm, pat
from rigs.scripted_model import LABELS, PressureDetector, Scripted

from touchd.daemon.path.decide import Decision, DecisionSettings
from touchd.daemon.path.events import Event, LivePrediction, Prediction, SensorEvent, TouchBegan, TouchEnded
from touchd.daemon.path.pipeline import Clock, Pipeline, PipelineSettings
from touchd.daemon.path.staleness import Staleness
from touchd.daemon.path.tracker import TouchSettings
from touchd.daemon.playback import stream as stream_module
from touchd.daemon.playback.stream import play
from touchd.drivers.frame import MAX_COUNT, NO_TOUCH, Counts, Frame, SensorState
from touchd.drivers.pad.grid import GridFrame
from touchd.drivers.recording import Stream, ideal_clock_ms, read_recordings, splice
from touchd.model.classifier import Classifier
from touchd.model.detector import Detector
from touchd.model.studies.simulated import simulate

STOPPED = Clock(monotonic_s=lambda: 100.0, epoch_s=lambda: 1795168800.0)
TIME = "2026-11-20T10:00:00.000Z"
LEAD_FRAMES = 108
EARLY, REVISED, FINAL = ("early", 54), ("revised", 81), ("final", 144)
DENT = nothing(2.0)
DENT[:, 1:7, 1:6] = 20.0


class Bench:
    """A pipeline fed by a made pad at `rate_hz`, and its events."""

    def __init__(
        self,
        model: Scripted | Classifier | None = None,
        *,
        rate_hz: float = 54.0,
        detector: Detector | None = None,
        **settings: Any,
    ) -> None:
        self.rate_hz = rate_hz
        self.model = model or Scripted()
        self.emitted: list[Event] = []
        self.now_s = STOPPED.monotonic_s()
        clock = Clock(lambda: self.now_s, STOPPED.epoch_s)
        if detector is None and not isinstance(model, Classifier):
            detector = PressureDetector()
        self.pipeline = Pipeline(
            PipelineSettings(**settings), self.model, self.emitted.append, clock, detector=detector
        )
        self.pad = MadePad()
        self.sent: list[Counts] = []
        self.clock_ms = 0.0
        self.feel(nothing(LEAD_FRAMES / 54))

    def feel(self, *pressures: Scans, skip: Sequence[int] = ()) -> list[Event]:
        """Lay pressure on the pad, losing the frames in `skip`; return the new events."""
        before = len(self.emitted)
        for number, counts in enumerate(self.pad.counts(np.concatenate(pressures))):
            if number not in skip:
                frame = Frame(round(self.clock_ms), self.now_s - 0.002, counts)
                self.pipeline.on_frame(frame)
            self.sent.append(counts)
            self.clock_ms += 1000 / self.rate_hz
        return self.emitted[before:]

    def check_windows(self, *lengths: int) -> None:
        """Check that the model got exactly this number of the touch's first frames."""
        windows = {len(window): window for window in self.model.stepped + self.model.asked}
        for length in lengths:
            np.testing.assert_array_equal(windows[length], self.sent[LEAD_FRAMES : LEAD_FRAMES + length])


def predictions(events: Sequence[Event]) -> list[Prediction]:
    return [event for event in events if isinstance(event, Prediction)]


def answered(events: Sequence[Event]) -> list[tuple[str, int]]:
    return [(event.stage, event.frames) for event in predictions(events)]


def told(events: Sequence[Event]) -> list[tuple[str, str]]:
    return [(event.stage, event.gesture) for event in predictions(events) if event.told]


def ended(events: Sequence[Event]) -> list[TouchEnded]:
    return [event for event in events if isinstance(event, TouchEnded)]


def test_a_touch_is_answered_early_revised_and_final() -> None:
    events = Bench().feel(palm(3.5), nothing(2.0))
    began, *answers, end = events
    assert answered(answers) == [EARLY, REVISED, FINAL]
    assert [answer.elapsed_s for answer in answers] == [1.0, 1.5, 2.667]
    assert told(events) == [("early", "stroke")]
    assert began == TouchBegan(touch=1, time=TIME, sensor_ms=2000)
    assert end.feel is not None
    assert end == TouchEnded(
        touch=1, gesture="stroke", frames=189, reason="released", time=TIME, sensor_ms=5481, feel=end.feel
    )


def test_a_prediction_has_every_field_a_listener_needs() -> None:
    (early,) = predictions(Bench().feel(palm(1.0)))
    assert early == Prediction(
        touch=1,
        stage="early",
        frames=54,
        elapsed_s=1.0,
        gesture="stroke",
        confidence=0.94,
        probabilities={label: 0.94 if label == "stroke" else 0.01 for label in LABELS},
        changed=True,
        told=True,
        degraded=False,
        latency_ms=2.0,
        model="scripted",
        time=TIME,
        age_ms=2.0,
        feel=early.feel,
    )


@pytest.mark.parametrize(
    ("scans", "expected"),
    [
        pytest.param([palm(3.0)], [EARLY, REVISED, FINAL], id="long"),
        pytest.param([palm(0.45), nothing(2.0)], [("released", 24 + 13)], id="short"),
        pytest.param([palm(1.2), nothing(2.0)], [EARLY, ("released", 65 + 13)], id="the second one deferred"),
        pytest.param(
            [palm(40 / 54), nothing(41 / 54), palm(2.0)],
            [("released", 40 + 13), REVISED, FINAL],
            id="overtaken",
        ),
        pytest.param([pat(3.0)], [EARLY, REVISED, FINAL], id="a pat and its lift-offs"),
        pytest.param([palm(0.5, 200.0), DENT], [EARLY, ("released", 29 + 13)], id="what a hand left"),
    ],
)
def test_every_answer_is_to_the_touchs_own_frames(
    scans: list[Scans], expected: list[tuple[str, int]]
) -> None:
    bench = Bench()
    events = bench.feel(*scans)
    assert answered(events) == expected
    bench.check_windows(*(frames for _, frames in expected))
    for end in ended(events):
        assert (end.frames + 13, end.gesture) == (expected[-1][1], "stroke")


@pytest.mark.parametrize(
    ("speak_above", "final_above", "off_frames", "gesture"),
    [
        pytest.param(0.65, 0.4, 13, "stroke", id="sure, at once"),
        pytest.param(0.95, 0.9, 27, "stroke", id="less sure, after half a second"),
        pytest.param(0.97, 0.96, 43, "uncertain", id="unsure, at the touch's end"),
    ],
)
def test_a_hand_that_left_is_answered_sooner_if_surely(
    speak_above: float, final_above: float, off_frames: int, gesture: str
) -> None:
    bench = Bench(decision=DecisionSettings(speak_above=speak_above, final_above=final_above))
    assert predictions(bench.feel(palm(0.5), nothing((off_frames - 1) / 54))) == []
    answer, *end = bench.feel(nothing(1 / 54))
    assert (answer.gesture, answer.told) == (gesture, True)
    assert (answer.perhaps, len(end)) == (("stroke", 1) if gesture == "uncertain" else ("", 0))
    assert len(end + bench.feel(nothing(1.0))) == 1


def test_a_hand_that_comes_back_continues_its_touch() -> None:
    bench = Bench()
    events = bench.feel(palm(0.5), nothing(0.5), palm(2.5))
    assert answered(events) == [("released", 27 + 13), EARLY, REVISED, FINAL]
    assert told(events) == [("released", "stroke")]


def test_a_hand_that_left_long_ago_has_no_early_answer() -> None:
    bench = Bench()
    bench.now_s += 500.0
    assert predictions(bench.feel(palm(0.5), nothing(0.4))) == []


def test_an_answer_due_in_a_pause_is_deferred() -> None:
    bench = Bench(decision=DecisionSettings(speak_above=0.95))
    assert answered(bench.feel(palm(0.7), nothing(0.45))) == []
    assert answered(bench.feel(palm(2.0))) == [EARLY, REVISED, FINAL]
    bench.check_windows(54)


def test_without_a_touch_the_model_gets_no_frames() -> None:
    bench = Bench()
    assert bench.feel(nothing(20.0)) == []
    assert bench.model.asked == bench.model.stepped == []


@pytest.mark.parametrize(
    ("scans", "answered_at"), [([palm(4.0)], [54, 81, 144]), ([palm(0.5), nothing(14 / 54)], [27 + 13])]
)
def test_one_frame_is_left_for_the_model_at_an_answer(scans: list[Scans], answered_at: list[int]) -> None:
    bench = Bench()
    bench.feel(*scans)
    lengths = [0, *(len(window) for window in bench.model.stepped)]
    assert [lengths[lengths.index(at) - 1] for at in answered_at] == [at - 1 for at in answered_at]
    assert max(after - before for before, after in pairwise(lengths)) == 9


PERIOD_S, READ_S = 1 / 54, 0.0186


def read_as_it_comes(scans: Counts, *, together: bool, **settings: Any) -> list[tuple[Event, float]]:
    """Return the events of a pad at 54 Hz, each with how long after its frame's arrival it came, in s.

    together: whether frames are read as many at once as the pipeline allows; otherwise one by one.
    """
    now_s, read_s, late = 0.0, 0.0, list[tuple[Event, float]]()

    def emit(event: Event) -> None:
        late.append((event, read_s - now_s))

    pipeline = Pipeline(PipelineSettings(**settings), Scripted(), emit, STOPPED, detector=PressureDetector())
    rests_until_s = 0.0
    for number, counts in enumerate(scans):
        now_s = number * PERIOD_S
        if now_s >= rests_until_s:
            # All that has arrived is read here, and the rest begins.
            read_s = now_s
            several = pipeline.frames_together if together else 1
            rests_until_s = now_s + (READ_S * several if several > 1 else 0.0)
        else:
            read_s = rests_until_s
        pipeline.on_frame(Frame(round(1000 * now_s), 99.998, counts))
    return late


@pytest.mark.parametrize(
    ("pressures", "settings"),
    [
        ([palm(3.5), nothing(2.0)], {}),
        ([palm(0.4), nothing(3.0), palm(0.1), nothing(3.0)], {}),
        ([pat(2.0), nothing(4.0), palm(6.0)], {}),
        ([palm(2.0), nothing(2.0)], {"decision": DecisionSettings(early="when_sure")}),
    ],
    ids=["a touch", "short touches", "pats", "when sure"],
)
def test_events_are_those_of_frames_read_one_by_one(pressures: list[Scans], settings: dict[str, Any]) -> None:
    scans = MadePad().counts(np.concatenate([nothing(12.0), *pressures]))
    one_by_one, at_once = (read_as_it_comes(scans, together=each, **settings) for each in (False, True))
    assert [event for event, _ in at_once] == [event for event, _ in one_by_one]
    assert any(isinstance(event, TouchBegan) for event, _ in at_once)
    for event, late_s in at_once:
        assert late_s <= (2 * PERIOD_S if isinstance(event, Prediction) else 0.06), event


def test_frames_are_read_singly_only_where_answers_are_due() -> None:
    bench = Bench()
    bench.feel(nothing(10.0))
    assert bench.pipeline.frames_together == 3
    bench.feel(palm(0.5))
    assert bench.pipeline.frames_together == 3
    bench.feel(palm(0.47))
    assert bench.pipeline.frames_together == 1


def test_a_model_without_notouch_names_touches_alone() -> None:
    bench = Bench(Scripted(labels=tuple(label for label in LABELS if label != NO_TOUCH)))
    assert bench.feel(nothing(3.0)) == []
    assert bench.model.asked == bench.model.stepped == []
    assert told(bench.feel(palm(3.5), nothing(2.0))) == [("early", "stroke")]


def test_viewers_see_the_models_answer_to_every_third_frame(classifier: Classifier) -> None:
    shown, emitted = list[LivePrediction](), list[Event]()
    scene = DecisionSettings(gestures=("pat", "stroke"))
    pipeline = Pipeline(
        PipelineSettings(decision=scene), classifier, emitted.append, STOPPED, viewers=lambda: [shown.append]
    )
    counts = MadePad().counts(np.concatenate([nothing(2.0), pat(3.0), nothing(1.0)]))
    clock_ms = ideal_clock_ms(len(counts))
    play(Stream(counts, clock_ms, ()), lambda _: pipeline)
    assert answered(emitted)[:3] == [EARLY, REVISED, FINAL]
    began = next(event for event in emitted if isinstance(event, TouchBegan))
    first = clock_ms.tolist().index(began.sensor_ms)
    assert [live.frames for live in shown] == list(range(3, 145, 3))
    for live in shown[::7]:
        said = classifier.probabilities(counts[first : first + live.frames])
        weighed = Decision(scene, classifier.labels).weigh(said)
        assert live == LivePrediction(touch=1, frames=live.frames, probabilities=live.probabilities)
        assert live.probabilities == pytest.approx(weighed, abs=1e-4)


def test_a_recording_gets_its_answers_on_a_slow_computer(
    classifier: Classifier, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream = splice(simulate([("notouch", 2.0), ("stroke", 3.0), ("notouch", 1.0)], 2))

    def told_at(frame_s: float) -> list[tuple[str, str]]:
        now_s, emitted = itertools.count(0.0, frame_s), list[Event]()
        monkeypatch.setattr(stream_module, "time", SimpleNamespace(monotonic=lambda: next(now_s)))
        play(stream, lambda clock: Pipeline(PipelineSettings(), classifier, emitted.append, clock))
        return [(event.stage, event.gesture) for event in predictions(emitted) if event.told]

    assert told_at(0.05) == told_at(1e-6)
    assert told_at(0.05)[-1] == ("released", "stroke")


def test_touches_are_named_wherever_the_pad_rests(classifier: Classifier) -> None:
    script = [("notouch", 3.0)]
    for gesture in ("stroke", "rub", "scratch", "pat"):
        script += [(gesture, 3.0), ("notouch", 1.5)]
    counts = splice(simulate(script, 2)).counts
    differ = np.random.default_rng(0).uniform(0.5, 1.5, (8, 8))

    def finals(rest_counts: int) -> list[str]:
        emitted: list[Event] = []
        resting = np.minimum(counts + np.rint(rest_counts * differ), MAX_COUNT).astype(np.uint16)
        pipeline = Pipeline(PipelineSettings(), classifier, emitted.append, STOPPED)
        play(Stream(resting, ideal_clock_ms(len(resting)), ()), lambda _: pipeline)
        return [event.gesture for event in predictions(emitted) if event.stage == "final"]

    assert finals(40) == finals(300) == ["stroke", "rub", "scratch", "pat"]


class Saying(Scripted):
    """A model whose gesture and confidence are chosen by a function of the calls before."""

    def __init__(self, says: Callable[[Scripted], tuple[str, float]]) -> None:
        super().__init__()
        self._says = says

    def answer(self) -> NDArray[np.float64]:
        gesture, confidence = self._says(self)
        rest = (1 - confidence) / (len(LABELS) - 1)
        return np.array([confidence if label == gesture else rest for label in LABELS])


@pytest.mark.parametrize(
    ("sure_from", "confidence", "speak_above", "early_at"),
    [
        *((sure_from, 0.94, 0.65, max(17, sure_from)) for sure_from in (1, 17, 23, 41, 53)),
        pytest.param(1, 0.6, 0.65, 54, id="never sure"),
        pytest.param(1, 0.94, 0.95, 54, id="too unsure to tell"),
    ],
)
def test_a_sure_answer_comes_before_its_mark(
    sure_from: int, confidence: float, speak_above: float, early_at: int
) -> None:
    scene = DecisionSettings(early="when_sure", speak_above=speak_above)
    model = Saying(lambda it: ("stroke" if len(it.stepped[-1]) >= sure_from else NO_TOUCH, confidence))
    answers = predictions(Bench(model, decision=scene).feel(palm(3.0)))
    assert answered(answers) == [("early", early_at), REVISED, FINAL]
    assert [answer.told for answer in answers][:2] == [confidence >= speak_above, False]
    assert answers[0].elapsed_s == pytest.approx(early_at / 54, abs=1e-3)


def test_a_lasting_change_of_gesture_is_told() -> None:
    bench = Bench(Scripted(lambda asked: "stroke" if asked <= 1 else "rub"))
    events = bench.feel(palm(8.0, counts=60.0), nothing(2.0))
    assert told(events) == [("early", "stroke"), ("ongoing", "rub")]
    assert answered(events) == [EARLY, REVISED, FINAL, ("ongoing", 42)]
    assert predictions(events)[-1].elapsed_s == 3.667
    assert [end.gesture for end in ended(events)] == ["rub"]


@pytest.mark.parametrize(("falls_to", "is_told"), [(0.3, False), (0.8, True)], ids=["leaves", "eases"])
def test_a_hand_that_leaves_a_soft_pad_changes_no_gesture(falls_to: float, is_told: bool) -> None:
    bench = Bench(Scripted(lambda asked: "stroke" if asked <= 1 else "rub"))
    load = 60.0 * falls_to ** np.linspace(0, 2, 108, dtype=np.float32)[:, None, None]
    events = bench.feel(palm(2.9, 60.0, trembling=False), load * palm(2.0, 1.0, trembling=False))
    assert told(events) == [("early", "stroke"), ("ongoing", "rub")][: 1 + is_told]


def test_a_gesture_in_one_window_alone_is_not_told() -> None:
    bench = Bench(Scripted(lambda asked: "rub" if asked % 2 else "stroke"))
    assert told(bench.feel(palm(8.0, counts=90.0), nothing(2.0))) == [("early", "stroke")]
    assert len(bench.model.asked) > 5


def test_a_noisy_pad_is_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    bench = Bench(detector=Detector.load())
    noise = np.random.default_rng(3).normal(0, 1.5, (1080, 8, 8)).astype(np.float32)
    states = [event.state for event in bench.feel(noise, nothing(20.0)) if isinstance(event, SensorEvent)]
    assert states == ["degraded", "up"]
    (warning,) = caplog.messages
    assert warning.startswith("light touches are not recognised: the pad is noisy")


def test_no_state_of_the_pad_but_down_ends_a_touch() -> None:
    bench = Bench()
    bench.feel(palm(0.5))
    bench.pipeline.on_sensor_state(SensorState("up", "frames arrive"))
    assert ended(bench.feel(palm(0.5))) == []


def test_the_log_names_a_pad_among_several(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    pipeline = Pipeline(PipelineSettings(), Scripted(), lambda event: None, STOPPED, pad="head")
    pipeline.on_sensor_state(SensorState("up", "frames arrive"))
    assert [record.getMessage().partition(": ")[0] for record in caplog.records] == ["head"]


def test_a_touch_taken_for_notouch_ends_uncertain_and_untold() -> None:
    bench = Bench(Scripted(lambda asked: "notouch"))
    for seconds, stages in ((4.0, ["early", "revised", "final", "uncertain"]), (1.2, ["early", "uncertain"])):
        events = bench.feel(palm(seconds, counts=60.0), nothing(2.0))
        assert [event.stage for event in predictions(events)] == stages
        assert told(events) == []
        assert [end.gesture for end in ended(events)] == ["uncertain"]


@pytest.mark.parametrize(
    ("sure_after", "said"),
    [(1000, ["uncertain"]), (3, ["uncertain", "stroke"])],
    ids=["for ever", "for a second"],
)
def test_a_lasting_unsure_touch_is_uncertain_once(sure_after: int, said: list[str]) -> None:
    model = Saying(lambda it: ("stroke", 0.94) if len(it.asked) > sure_after else ("rub", 0.6))
    bench = Bench(model, decision=DecisionSettings(final_above=0.7))
    events = bench.feel(palm(6.0, counts=60.0), nothing(2.0))
    assert answered(events)[:3] == [EARLY, REVISED, ("uncertain", 144)]
    assert [gesture for _, gesture in told(events)] == said
    assert [answer.perhaps for answer in predictions(events)][2] == "rub"
    assert [end.gesture for end in ended(events)] == said[-1:]


@pytest.mark.parametrize(
    ("scans", "lost", "degraded"),
    [
        pytest.param(palm(3.0), [60, 61], [False, True, True], id="between two answers"),
        pytest.param(palm(3.0), [1], [True, True, True], id="before the onset"),
        pytest.param(palm(4.0), range(140, 147), [False, False, True], id="when an answer is due"),
    ],
)
def test_lost_frames_mark_the_touchs_later_answers_degraded(
    scans: Scans, lost: Sequence[int], degraded: list[bool]
) -> None:
    bench = Bench(detector=Detector.load(), touch=TouchSettings(quiet_s=0.1))
    events = bench.feel(scans, nothing(2.0), skip=lost)
    assert answered(events) == [EARLY, REVISED, FINAL]
    assert [event.degraded for event in predictions(events)] == degraded
    assert not any(event.degraded for event in predictions(bench.feel(palm(3.0))))


def test_touches_after_a_reset_of_the_board_are_told() -> None:
    bench = Bench()
    for bench.clock_ms in (100_000.0, 1000.0):
        events = bench.feel(nothing(2.0), palm(2.0), nothing(2.0))
        assert [end.gesture for end in ended(events)] == ["stroke"]
        assert max(answer.age_ms for answer in predictions(events)) < 1000.0


def test_a_gap_too_long_to_bridge_ends_the_touch() -> None:
    events = Bench().feel(palm(3.0), skip=range(100, 120))
    (end,) = ended(events)
    assert (end.touch, end.reason, end.frames) == (1, "gap", 100)
    assert [event.touch for event in events if isinstance(event, TouchBegan)] == [1, 2]
    assert ("released", 100) in answered(events)


def test_losing_the_sensor_ends_its_touch_first() -> None:
    bench = Bench()
    bench.feel(palm(0.5))
    bench.emitted.clear()
    bench.pipeline.on_sensor_state(SensorState("down", "unplugged"))
    released, end, down = bench.emitted
    assert answered([released]) == [("released", 27)]
    assert (type(end), end.reason) == (TouchEnded, "sensor")
    assert down == SensorEvent(state="down", reason="unplugged", time=TIME)


@pytest.mark.parametrize(("clock_ms", "away_s"), [(60_000, 0.0), (0, 60.0)])
def test_a_returning_pad_is_calibrated_and_answered_again(clock_ms: int, away_s: float) -> None:
    bench = Bench()
    bench.pipeline.on_sensor_state(SensorState("down", "unplugged"))
    bench.pipeline.on_sensor_state(SensorState("up", ""))
    bench.pad.rest += 30
    bench.clock_ms += clock_ms
    bench.now_s += away_s
    assert bench.feel(nothing(2.0)) == []
    assert told(bench.feel(palm(3.5), nothing(2.0))) == [("early", "stroke")]


@pytest.mark.parametrize("jump_ms", [-900, 100, 60_000])
def test_a_returning_pads_older_frames_have_no_part_in_touches(jump_ms: int) -> None:
    def begins_after_ms(jump_ms: int) -> float:
        bench = Bench(detector=Detector.load())
        bench.feel(palm(2.0, 300.0))
        bench.pipeline.on_sensor_state(SensorState("down", "unplugged"))
        bench.pipeline.on_sensor_state(SensorState("up", ""))
        bench.clock_ms = back_ms = round(bench.clock_ms) + jump_ms
        events = bench.feel(nothing(0.3), palm(1.5), nothing(1.5))
        return [event.sensor_ms - back_ms for event in events if isinstance(event, TouchBegan)][-1]

    assert begins_after_ms(jump_ms) == pytest.approx(begins_after_ms(5000), abs=1)


@pytest.mark.parametrize(("late_s", "is_told"), [(2.9, True), (3.3, False), (5.0, False)])
def test_a_revision_that_comes_too_late_is_not_told(late_s: float, is_told: bool) -> None:
    bench = Bench(Saying(lambda it: ("rub" if len(it.stepped[-1]) > EARLY[1] else "stroke", 0.94)))
    assert told(bench.feel(palm(1.2))) == [("early", "stroke")]
    # The next frames were held up on their way.
    bench.now_s += late_s
    late = bench.feel(palm(0.6))
    assert answered(late) == [REVISED]
    assert told(late) == ([("revised", "rub")] if is_told else [])
    # Its newest frame is the sixteenth of those that came together.
    assert predictions(late)[0].age_ms == pytest.approx(1000 * late_s - 16 * 1000 / 54, abs=2)


@pytest.mark.parametrize(
    ("lags_s", "age_s"),
    [
        pytest.param([0.1] * 54, 0.0, id="in time"),
        pytest.param([*[0.1] * 54, 3.1], 3.0, id="held up"),
        pytest.param([0.6, *[0.1] * 54, 3.1], 3.0, id="held up, after a late beginning"),
        pytest.param([*[0.1] * 54, *np.linspace(3.1, 0.1, 163)], 0.0, id="in time again"),
        pytest.param(np.linspace(0.0, 5.0, 5400), 0.0, id="by a slow clock"),
        pytest.param(np.linspace(5.0, 0.0, 5400), 0.0, id="by a fast clock"),
        pytest.param([*[0.1] * 54, *[1.1] * 1350], 0.5, id="late for half a minute"),
        pytest.param([*[0.1] * 54, *[1.1] * 2800], 0.0, id="late for a minute"),
    ],
)
def test_a_frame_is_as_old_as_it_was_held_up(lags_s: Sequence[float], age_s: float) -> None:
    staleness = Staleness()
    for number, lag_s in enumerate(lags_s):
        sent_s = number / 54
        frame = GridFrame(number, 1000 * sent_s, sent_s + lag_s, np.zeros((8, 8), np.float32), False, False)
        staleness.update(frame)
    assert staleness.age_s(frame, frame.host_s) == pytest.approx(age_s, abs=0.01)
    # After a reset of the board its clock restarts, but its frames are not older.
    restarted = msgspec.structs.replace(frame, sensor_ms=0.0)
    staleness.update(restarted)
    assert staleness.age_s(restarted, frame.host_s) == pytest.approx(0.0)
    staleness.forget()
    assert staleness.age_s(frame, frame.host_s + 100.0) == 0.0


def test_the_end_of_the_stream_ends_the_touch_once() -> None:
    bench = Bench()
    bench.feel(palm(0.5))
    bench.emitted.clear()
    bench.pipeline.flush()
    bench.pipeline.flush()
    assert [type(event) for event in bench.emitted] == [Prediction, TouchEnded]
    assert bench.emitted[-1].reason == "stopped"


@pytest.mark.parametrize("stages", [(10, 20, 30), (54, 81, 432)])
def test_a_scene_chooses_when_to_answer(stages: tuple[int, int, int]) -> None:
    bench = Bench(decision=DecisionSettings(answer_at_frames=stages))
    assert [event.frames for event in predictions(bench.feel(palm(8.5)))] == list(stages)


class Fickle(Scripted):
    """A model with random answers."""

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__()
        self._rng = rng

    def answer(self) -> NDArray[np.float64]:
        window = (self.stepped or self.asked)[-1]
        assert window.min() >= 0
        assert window.max() <= MAX_COUNT
        return self._rng.dirichlet(np.full(len(LABELS), 0.3))


SEEDS = [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 8))]


@pytest.mark.parametrize("seed", SEEDS)
def test_every_touch_is_answered_ended_and_told_once(seed: int) -> None:
    rng = np.random.default_rng(seed)
    emitted: list[Event] = []
    scene = DecisionSettings(speak_above=rng.uniform())
    pipeline = Pipeline(PipelineSettings(decision=scene), Fickle(rng), emitted.append, STOPPED)
    pad, clock_ms, rate_hz = MadePad(seed), 0.0, rng.choice([30, 50, 54, 60, 100])
    for _ in range(30):
        counts, seconds = rng.uniform(3, 900), rng.choice([0.1, 0.3, 1.0, 3.0])
        hand = rng.choice([0, 1, 2])
        scans = (nothing(seconds), palm(seconds, counts), pat(seconds, counts))[hand]
        for scan in pad.counts(scans):
            pipeline.on_frame(Frame(int(clock_ms) % 2**32, 0.0, scan))
            mishap = rng.choice([0.0, rng.uniform(-30, 60), rng.uniform(-3000, 3000)], p=[0.97, 0.02, 0.01])
            clock_ms += 1000 / rate_hz + mishap
        if rng.uniform() < 0.1:
            pipeline.on_sensor_state(SensorState("down", "unplugged"))
    pipeline.flush()

    audit = Audit()
    for event in emitted:
        audit.see(event)
    assert (list(audit.wrong), audit.is_open) == ([], False)
    assert audit.touches > 0


def test_light_touches_after_firm_ones_are_detected(classifier: Classifier) -> None:
    # The recording ends with a resting hand's pats, far lighter than the pressure before.
    twice = splice(read_recordings(LENGTHS) * 2)
    events = answers(twice, classifier)
    spans = [span for span in twice.spans if span.gesture != NO_TOUCH]
    made = len(spans) - sum(one.stop == other.start for one, other in pairwise(spans))
    assert sum(isinstance(event, TouchBegan) for event in events) == made
