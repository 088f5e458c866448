"""Which answers are told to the robot, and when they are revised."""

import numpy as np
import pytest
from numpy.typing import NDArray

from touchd.daemon.path.decide import ENDED_NOTOUCH, Decision, DecisionSettings, told_in
from touchd.daemon.path.events import Stage

LABELS = ("constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle")
SETTINGS = DecisionSettings(speak_above=0.6)


def probabilities(**given: float) -> NDArray[np.float64]:
    """Return probabilities; the labels not given share the rest equally."""
    rest = (1.0 - sum(given.values())) / (len(LABELS) - len(given))
    return np.array([given.get(label, rest) for label in LABELS])


# A stage with its probabilities; the answer's gesture, and whether it is changed and told.
Step = tuple[Stage, dict[str, float], str, bool, bool]
SURE_STROKE = {"stroke": 0.8}
SEQUENCES: dict[str, list[Step]] = {
    "a sure answer is told early, once": [
        ("early", SURE_STROKE, "stroke", True, True),
        ("revised", SURE_STROKE, "stroke", False, False),
        ("final", SURE_STROKE, "stroke", False, False),
        ("ongoing", SURE_STROKE, "stroke", False, False),
    ],
    "confidence of exactly speak_above is enough": [("early", {"stroke": 0.6}, "stroke", True, True)],
    "an unsure answer waits until it is sure": [
        ("early", {"stroke": 0.59}, "stroke", True, False),
        ("revised", {"stroke": 0.61}, "stroke", False, True),
        ("final", {"stroke": 0.9}, "stroke", False, False),
    ],
    "at final less confidence is enough": [
        ("revised", {"stroke": 0.4}, "stroke", True, False),
        ("final", {"stroke": 0.4}, "stroke", False, True),
    ],
    "an answer never sure becomes uncertain at final": [
        ("early", {"stroke": 0.3}, "stroke", True, False),
        ("revised", {"stroke": 0.39}, "stroke", False, False),
        ("final", {"stroke": 0.39}, "uncertain", True, True),
    ],
    "an uncertain touch is told once it becomes sure": [
        ("final", {"stroke": 0.39}, "uncertain", True, True),
        ("ongoing", {"stroke": 0.55}, "stroke", True, False),
        ("ongoing", {"stroke": 0.65}, "stroke", True, True),
        ("ongoing", {"stroke": 0.95}, "stroke", False, False),
    ],
    "a pause at final is no doubt": [
        ("final", {"notouch": 0.4}, "notouch", True, False),
        ("ongoing", {"stroke": 0.65}, "stroke", True, True),
    ],
    "before anything is told the best answer stands, by whatever margin": [
        ("early", {"stroke": 0.40, "rub": 0.39}, "stroke", True, False),
        ("revised", {"stroke": 0.40, "rub": 0.41}, "rub", True, False),
        ("final", {"stroke": 0.42, "rub": 0.41}, "stroke", True, True),
    ],
    "what was told stands against one that is only a little better": [
        ("early", SURE_STROKE, "stroke", True, True),
        ("revised", {"stroke": 0.35, "rub": 0.40}, "stroke", False, False),
        ("final", {"stroke": 0.35, "rub": 0.40}, "stroke", False, False),
    ],
    "at final it gives way to a less sure one": [
        ("early", SURE_STROKE, "stroke", True, True),
        ("revised", {"stroke": 0.20, "rub": 0.40}, "stroke", False, False),
        ("final", {"stroke": 0.20, "rub": 0.40}, "rub", True, True),
    ],
    "doubt at final takes nothing back": [
        ("early", SURE_STROKE, "stroke", True, True),
        ("final", {"stroke": 0.20, "rub": 0.39}, "stroke", False, False),
    ],
    "before final it gives way only to a sure one": [
        ("early", SURE_STROKE, "stroke", True, True),
        ("revised", {"stroke": 0.20, "rub": 0.65}, "rub", True, True),
        ("final", {"rub": 0.65}, "rub", False, False),
    ],
    "a changed mind may change back": [
        ("early", SURE_STROKE, "stroke", True, True),
        ("revised", {"rub": 0.8}, "rub", True, True),
        ("final", SURE_STROKE, "stroke", True, True),
    ],
    "while a touch goes on only a sure change is told": [
        ("final", {"stroke": 0.5}, "stroke", True, True),
        ("ongoing", {"rub": 0.55}, "stroke", False, False),
        ("ongoing", {"rub": 0.65}, "rub", True, True),
        ("ongoing", {"rub": 0.95}, "rub", False, False),
    ],
    "an answer told after an unreported one has changed": [
        ("final", {"notouch": 0.9}, "notouch", True, False),
        ("ongoing", {"rub": 0.55}, "rub", True, False),
        ("ongoing", {"rub": 0.9}, "rub", True, True),
    ],
    "no touch is never told": [
        ("early", {"notouch": 0.95}, "notouch", True, False),
        ("revised", {"notouch": 0.95}, "notouch", False, False),
        ("final", {"notouch": 0.95}, "notouch", False, False),
        ("uncertain", {"notouch": 0.95}, "uncertain", True, False),
    ],
    "no touch takes nothing back": [
        ("early", SURE_STROKE, "stroke", True, True),
        ("final", {"notouch": 0.95}, "stroke", False, False),
    ],
    "any touch replaces no touch": [
        ("early", {"notouch": 0.45, "pat": 0.4}, "notouch", True, False),
        ("revised", {"notouch": 0.40, "pat": 0.41}, "pat", True, False),
        ("final", {"notouch": 0.40, "pat": 0.41}, "pat", False, True),
    ],
    "a short touch is answered when it ends": [("released", {"pat": 0.7}, "pat", True, True)],
    "a short touch that was told is not told again": [
        ("early", {"pat": 0.7}, "pat", True, True),
        ("released", {"pat": 0.9}, "pat", False, False),
    ],
    "a short touch may be told otherwise at its end": [
        ("early", {"pat": 0.7}, "pat", True, True),
        ("released", {"tickle": 0.7}, "tickle", True, True),
    ],
    "a short touch that stays unsure ends in uncertain": [
        ("early", {"pat": 0.3}, "pat", True, False),
        ("released", {"pat": 0.36}, "uncertain", True, True),
    ],
    "a short touch that has ended is told from a lower confidence on": [
        ("early", {"pat": 0.45}, "pat", True, False),
        ("released", {"pat": 0.45}, "pat", False, True),
    ],
    "a touch followed to its end is named though no touch seems as likely": [
        ("released", {"pat": 0.40, "notouch": 0.55}, "pat", True, True),
    ],
    "a short touch that the model takes for none ends in uncertain, and the robot is not told": [
        ("released", {"notouch": 0.9}, "uncertain", True, False),
    ],
    "a short touch that was told and then is unsure keeps its answer": [
        ("early", {"pat": 0.7}, "pat", True, True),
        ("released", {"pat": 0.2, "rub": 0.3}, "pat", False, False),
    ],
}


@pytest.mark.parametrize("steps", SEQUENCES.values(), ids=SEQUENCES.keys())
def test_each_answer_is_reported_and_told_as_expected(steps: list[Step]) -> None:
    decision = Decision(SETTINGS, LABELS)
    told_last = None
    for stage, given, gesture, changed, told in steps:
        answer = decision.answer(stage, probabilities(**given))
        assert (answer.gesture, answer.changed, answer.told) == (gesture, changed, told)
        is_uncertain = gesture == "uncertain"
        assert answer.stage == ("uncertain" if is_uncertain else stage)
        named = max(given, key=given.__getitem__) if is_uncertain else gesture
        said = dict(zip(LABELS, probabilities(**given), strict=True))
        if stage in ("released", "uncertain"):
            said["notouch"] *= ENDED_NOTOUCH
        assert answer.confidence == pytest.approx(said[named] / sum(said.values()))
        told_last = gesture if told and not is_uncertain else told_last
    assert decision.told == told_last


@pytest.mark.parametrize("stage", ["revised", "final", "released", "ongoing"])
def test_an_answer_that_is_too_late_replaces_nothing(stage: Stage) -> None:
    decision = Decision(SETTINGS, LABELS)
    decision.answer("early", probabilities(stroke=0.8))
    answer = decision.answer(stage, probabilities(rub=0.9), may_tell=False)
    assert (answer.gesture, answer.told, decision.told) == ("stroke", False, "stroke")


@pytest.mark.parametrize("label", LABELS)
def test_every_gesture_can_be_told_and_no_touch_cannot(label: str) -> None:
    said, is_touch = probabilities(**{label: 0.9}), label != "notouch"
    eager = DecisionSettings(early="when_sure")
    assert Decision(SETTINGS, LABELS).answer("early", said).told == is_touch
    assert Decision(eager, LABELS).is_sure(said, 54) == is_touch
    assert Decision(SETTINGS, LABELS).is_sure_of_released(said, is_over=False) == is_touch
    ended = Decision(SETTINGS, LABELS).answer("uncertain", said)
    assert (ended.told, ended.perhaps) == (is_touch, label if is_touch else "")


def test_limits_are_reached_by_equal_values() -> None:
    settings = DecisionSettings(gestures=("rub", "stroke"), speak_above=0.5)
    decision = Decision(settings, LABELS)
    stroke, rub = (
        probabilities(**said)
        for said in (
            {"stroke": 0.5, "rub": 0.25, "notouch": 0.25},
            {"rub": 0.5, "stroke": 0.25, "notouch": 0.25},
        )
    )
    assert decision.is_sure_of_released(stroke, is_over=False)
    assert decision.answer("early", stroke).told
    assert decision.answer("revised", rub).told


def test_a_scene_shares_probability_among_its_gestures() -> None:
    decision = Decision(DecisionSettings(gestures=("stroke", "pat")), LABELS)
    answer = decision.answer("early", probabilities(rub=0.5, stroke=0.3, pat=0.1, notouch=0.1))
    assert answer.gesture == "stroke"
    assert answer.probabilities == pytest.approx(
        {"constant": 0, "notouch": 0.2, "pat": 0.2, "rub": 0, "scratch": 0, "stroke": 0.6, "tickle": 0}
    )


def test_a_touch_that_is_none_of_the_gestures_can_occur_in_every_scene() -> None:
    decision = Decision(DecisionSettings(gestures=("stroke", "pat")), (*LABELS, "other"))
    answer = decision.answer("early", np.array([0.1, 0.05, 0.05, 0.1, 0.0, 0.0, 0.0, 0.7]))
    assert (answer.gesture, answer.told) == ("other", True)


@pytest.mark.parametrize(
    ("gestures", "labels", "named"),
    [
        ((), ("hug", "notouch", "pat"), ("hug", "pat")),
        ((), ("notouch", "other", "pat"), ("other", "pat")),
        (("pat",), ("hug", "notouch", "other", "pat"), ("other", "pat")),
        (("pat",), ("hug", "notouch", "pat"), ("pat",)),
    ],
)
def test_a_scenes_answers_name_its_gestures_and_other(
    gestures: tuple[str, ...], labels: tuple[str, ...], named: tuple[str, ...]
) -> None:
    assert told_in(gestures, labels) == named


def test_a_scene_the_model_rules_out_is_answered_evenly() -> None:
    decision = Decision(DecisionSettings(gestures=("stroke", "pat")), LABELS)
    answer = decision.answer("early", probabilities(rub=1.0))
    assert answer.confidence == pytest.approx(1 / 3)
    assert not answer.told


@pytest.mark.parametrize("stages", [(54, 54, 144), (54, 144, 81), (54, 144, 144)])
def test_stages_out_of_order_are_refused(stages: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match="must rise"):
        DecisionSettings(answer_at_frames=stages)


def test_a_hand_that_has_just_left_is_answered_from_speak_above_on() -> None:
    decision = Decision(SETTINGS, LABELS)
    assert decision.is_sure_of_released(probabilities(pat=0.6), is_over=False)
    assert not decision.is_sure_of_released(probabilities(pat=0.59), is_over=False)
    assert not decision.is_sure_of_released(probabilities(notouch=0.9), is_over=False)


def test_a_hand_that_has_been_off_for_half_a_second_is_answered_from_final_above_on() -> None:
    decision = Decision(DecisionSettings(final_above=0.3), LABELS)
    pat, less = (probabilities(pat=value, rub=0.1, stroke=0.1) for value in (0.27, 0.26))
    assert decision.is_sure_of_released(pat, is_over=True)
    assert not decision.is_sure_of_released(less, is_over=True)
    assert not decision.is_sure_of_released(probabilities(notouch=0.99), is_over=True)


def test_a_final_answer_below_final_above_is_a_guess() -> None:
    unsure, sure = (
        Decision(DecisionSettings(final_above=0.5), LABELS).answer("final", probabilities(stroke=value))
        for value in (0.49, 0.5)
    )
    assert (unsure.stage, unsure.gesture, unsure.perhaps) == ("uncertain", "uncertain", "stroke")
    assert (sure.stage, sure.gesture, sure.perhaps) == ("final", "stroke", "")


@pytest.mark.parametrize(
    ("stage", "said", "is_answered"),
    [
        ("early", {"stroke": 0.5}, False),
        ("early", {"stroke": 0.7}, True),
        ("final", {"stroke": 0.39}, True),
        ("final", {"notouch": 0.9}, False),
    ],
)
def test_a_touch_is_answered_once_it_has_a_name_or_none(
    stage: Stage, said: dict[str, float], is_answered: bool
) -> None:
    decision = Decision(SETTINGS, LABELS)
    decision.answer(stage, probabilities(**said))
    assert decision.is_answered == is_answered


def test_less_confidence_is_required_later_in_a_touch() -> None:
    decision = Decision(DecisionSettings(early="when_sure", speak_above=0.0), LABELS)
    first = {}
    for hundredth in (50, 60, 70, 80, 90, 99):
        said = probabilities(stroke=hundredth / 100)
        first[hundredth] = next(at for at in range(1, 433) if decision.is_sure(said, at))
    assert sorted(first.values(), reverse=True) == list(first.values())
    assert first[99] < 30 < first[50]
    assert not any(decision.is_sure(probabilities(notouch=1.0), at) for at in range(1, 433))


def test_no_answer_is_sure_before_a_quarter_of_a_second() -> None:
    decision = Decision(DecisionSettings(early="when_sure"), LABELS)
    assert [at for at in range(1, 16) if decision.is_sure(probabilities(stroke=1.0), at)] == [13, 14, 15]


def test_an_early_answer_of_exactly_speak_above_is_sure() -> None:
    decision = Decision(DecisionSettings(early="when_sure", speak_above=0.8), LABELS)
    assert decision.is_sure(probabilities(stroke=0.8), 54)
    assert not decision.is_sure(probabilities(stroke=0.79), 54)


@pytest.mark.parametrize(
    ("at_final", "lately", "changed"),
    [
        ({"stroke": 0.9, "rub": 0.01}, {"rub": 0.9, "stroke": 0.01}, True),
        ({"stroke": 0.9, "rub": 0.01}, {"rub": 0.5, "stroke": 0.3}, False),
        ({"stroke": 0.5, "rub": 0.4}, {"rub": 0.9, "stroke": 0.01}, False),
        ({"stroke": 0.9, "rub": 0.01}, {"stroke": 0.9, "rub": 0.01}, False),
        ({"stroke": 0.97, "rub": 0.005}, {"rub": 0.85, "stroke": 0.1}, True),
        ({"stroke": 0.97, "rub": 0.005}, {"rub": 0.8, "stroke": 0.15}, False),
        ({"stroke": 0.98, "rub": 0.0001}, {"rub": 0.45, "stroke": 0.4}, False),
        ({"stroke": 0.8, "rub": 0.04}, {"rub": 0.8, "stroke": 0.04}, False),
    ],
)
def test_a_gesture_changes_only_on_clear_evidence(
    at_final: dict[str, float], lately: dict[str, float], changed: bool
) -> None:
    decision = Decision(DecisionSettings(), LABELS)
    decision.answer("final", probabilities(**at_final))
    assert decision.has_changed(probabilities(**lately)) == changed
