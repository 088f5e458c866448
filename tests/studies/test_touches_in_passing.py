"""The study of touches in passing: which touches it makes, and how it scores what was told."""

from collections.abc import Sequence

import numpy as np
import pytest
from msgspec.structs import replace
from rigs.made_events import PREDICTION

from touchd.daemon.path.events import Event, Prediction, Stage, TouchBegan, TouchEnded, timestamp
from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.studies.sessions import changes, passing
from touchd.model.studies.sessions.passing import PassingSession, PassingTouch, judge, score

PATS = [(30, 38), (60, 68), (90, 98), (120, 128)]


def recording(gesture: str, touched: Sequence[tuple[int, int]], frames: int = 431) -> Recording:
    counts = np.full((frames, 8, 8), 2, np.uint16)
    for first, stop in touched:
        counts[first:stop, 2:5, 2:5] += 150
    return Recording("P3", "foam", "fur", gesture, counts, ideal_clock_ms(frames), "live")


def test_each_recording_gives_touches_that_a_visitor_makes() -> None:
    made = [recording("notouch", []), recording("pat", PATS), recording("rub", [(0, 431)])]
    (session,) = passing.sessions(made)
    kinds = sorted((touch.gesture, touch.kind) for touch in session.touches)
    assert kinds == [("pat", "one"), ("pat", "three"), ("rub", "0.5 s"), ("rub", "1 s"), ("rub", "2 s")]
    frames = sorted(touch.stop - touch.start for touch in session.touches if touch.gesture == "rub")
    assert frames == [27, 54, 108]
    for touch in session.touches:
        after = session.counts[touch.stop : touch.stop + passing.REST_FRAMES].astype(int)
        assert abs(after - 2).max() <= 8


def answer(stage: Stage, gesture: str, at_s: float, touch: int = 1, **probabilities: float) -> Prediction:
    return replace(
        PREDICTION,
        touch=touch,
        stage=stage,
        gesture=gesture,
        probabilities=probabilities or {gesture: 0.9},
        time=timestamp(at_s),
        perhaps=max(probabilities, default="", key=lambda name: probabilities[name]),
    )


def touch_at(start_s: float, *answers: Prediction, number: int = 1) -> list[Event]:
    began = TouchBegan(touch=number, time=timestamp(start_s), sensor_ms=round(1000 * start_s))
    ended = TouchEnded(
        touch=number,
        gesture="",
        frames=27,
        reason="released",
        time=timestamp(start_s + 1.3),
        sensor_ms=round(1000 * start_s) + 500,
    )
    return [began, *answers, ended]


STROKE = PassingTouch("stroke", "one", 162, 189)
SESSION = PassingSession("P3", np.zeros((400, 8, 8), np.uint16), (STROKE,))


@pytest.mark.parametrize(
    ("events", "expected"),
    [
        ([], {"right": 0.0, "missed": 100.0, "several": 0.0}),
        (touch_at(3.0, answer("released", "stroke", 3.75)), {"right": 100.0, "answered_s": 0.25}),
        (
            touch_at(3.0, answer("uncertain", "uncertain", 4.3, stroke=0.35, rub=0.3)),
            {"right": 0.0, "right_of_named": 0.0, "perhaps": 100.0},
        ),
        (
            touch_at(3.0, answer("early", "stroke", 3.9), answer("released", "rub", 4.3)),
            {"right": 0.0, "harmful": 100.0},
        ),
        (
            [*touch_at(3.0, answer("released", "stroke", 3.75)), *touch_at(3.3, number=2)],
            {"several": 100.0},
        ),
    ],
    ids=["missed", "right", "perhaps", "told right, then wrong", "several"],
)
def test_a_touch_is_scored_by_what_was_told_last(events: list[Event], expected: dict[str, float]) -> None:
    found = score(judge(SESSION, events))
    assert {name: getattr(found, name) for name in expected} == pytest.approx(expected)


def test_a_lower_limit_names_more_of_the_ended_touches() -> None:
    (outcome,) = judge(SESSION, touch_at(3.0, answer("uncertain", "uncertain", 4.3, stroke=0.35, rub=0.3)))
    assert passing.curve([outcome], (0.3, 0.4)) == [(0.3, 100.0, 100.0), (0.4, 0.0, 0.0)]


def test_a_change_counts_once_both_gestures_were_told() -> None:
    pair = changes.Pair("rub", "pat", np.zeros((1, 8, 8), np.uint16), changes=324)
    at_s = 324 / 54
    events = [answer("early", "rub", 3.0), answer("ongoing", "pat", at_s + 1.2)]
    outcomes = [changes.judge(pair, events), changes.judge(pair, [answer("early", "stroke", 3.0)])]
    found = changes.score(outcomes)
    assert (found.both, found.last, found.third, found.after_s, found.n) == (50.0, 50.0, 50.0, 1.2, 2)


def test_a_pair_is_two_gestures_without_rest_between() -> None:
    recordings = [recording("notouch", []), recording("pat", [(0, 431)]), recording("rub", [(0, 431)])]
    touched = next(changes.pairs(recordings)).counts[:, 3, 3] > 2
    assert len(touched) == 108 + 432 + 108
    assert touched[108:540].all()
    assert touched.sum() == 432
