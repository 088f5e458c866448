"""Which answers are told to the robot, and when they are revised."""

import numpy as np
import pytest
from numpy.typing import NDArray

from touchd.daemon.path.decide import ENDED_NOTOUCH, Decision, DecisionSettings, answerable
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
    told_last, is_answered = None, False
    for stage, given, gesture, changed, told in steps:
        answer = decision.answer(stage, probabilities(**given))
        assert (answer.gesture, answer.changed, answer.told) == (gesture, changed, told)
        is_uncertain = gesture == "uncertain"
        assert answer.stage == ("uncertain" if is_uncertain else stage)
        named = max(given, key=given.__getitem__) if is_uncertain else gesture
        assert answer.perhaps == (named if is_uncertain and named != "notouch" else "")
        said = dict(zip(LABELS, probabilities(**given), strict=True))
        if stage in ("released", "uncertain"):
            said["notouch"] *= ENDED_NOTOUCH
        assert answer.confidence == pytest.approx(said[named] / sum(said.values()))
        told_last = gesture if told and not is_uncertain else told_last
        is_answered = is_answered or told or is_uncertain
        assert decision.is_answered == is_answered
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


@pytest.mark.parametrize(
    ("said", "weighed"),
    [
        (
            {"rub": 0.5, "stroke": 0.3, "pat": 0.1, "notouch": 0.1},
            {"stroke": 0.6, "pat": 0.2, "notouch": 0.2},
        ),
        ({"other": 0.7, "rub": 0.2, "pat": 0.1}, {"other": 0.875, "pat": 0.125}),
        # The model rules the scene out.
        ({"rub": 1.0}, {"notouch": 0.25, "other": 0.25, "pat": 0.25, "stroke": 0.25}),
    ],
)
def test_a_scenes_gestures_and_other_share_the_probability(
    said: dict[str, float], weighed: dict[str, float]
) -> None:
    labels = (*LABELS, "other")
    decision = Decision(DecisionSettings(gestures=("stroke", "pat")), labels)
    answer = decision.answer("early", np.array([said.get(label, 0.0) for label in labels]))
    assert answer.probabilities == pytest.approx(dict.fromkeys(labels, 0.0) | weighed)
    assert answer.told == (max(weighed.values()) > 0.65)


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
    assert answerable(gestures, labels) == named


@pytest.mark.parametrize("stages", [(54, 54, 144), (54, 144, 81), (54, 144, 144), (81, 54, 144)])
def test_stages_out_of_order_are_refused(stages: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match="must rise"):
        DecisionSettings(answer_at_frames=stages)


@pytest.mark.parametrize(
    ("is_over", "said", "is_sure"),
    [
        (False, {"pat": 0.5, "rub": 0.25, "notouch": 0.25}, True),
        (False, {"pat": 0.49, "rub": 0.25, "notouch": 0.26}, False),
        (False, {"notouch": 0.9}, False),
        (True, {"pat": 0.27, "rub": 0.1, "stroke": 0.1}, True),
        (True, {"pat": 0.26, "rub": 0.1, "stroke": 0.1}, False),
        (True, {"notouch": 0.99}, False),
    ],
)
def test_half_a_second_off_the_pad_final_above_is_enough(
    is_over: bool, said: dict[str, float], is_sure: bool
) -> None:
    decision = Decision(DecisionSettings(speak_above=0.5, final_above=0.3), LABELS)
    assert decision.is_sure_of_released(probabilities(**said), is_over=is_over) == is_sure


def test_less_confidence_is_required_later_in_a_touch() -> None:
    decision = Decision(DecisionSettings(early="when_sure", speak_above=0.0), LABELS)
    first = {}
    for hundredth in (50, 60, 70, 80, 90, 99):
        said = probabilities(stroke=hundredth / 100)
        first[hundredth] = next(at for at in range(1, 433) if decision.is_sure(said, at))
    assert sorted(first.values(), reverse=True) == list(first.values())
    assert first[99] < 30 < first[50]


@pytest.mark.parametrize(
    ("stroke", "speak_above", "at", "is_sure"),
    [
        # No answer is sure before a quarter of a second.
        (1.0, 0.65, 12, False),
        (1.0, 0.65, 13, True),
        (0.8, 0.8, 54, True),
        (0.79, 0.8, 54, False),
        (0.79, 0.8, 432, False),
    ],
)
def test_an_early_answer_reaches_speak_above_too(
    stroke: float, speak_above: float, at: int, is_sure: bool
) -> None:
    decision = Decision(DecisionSettings(early="when_sure", speak_above=speak_above), LABELS)
    assert decision.is_sure(probabilities(stroke=stroke), at) == is_sure


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
        # Nothing was told; any touch is another answer.
        ({"stroke": 0.3}, {"stroke": 0.3}, True),
        ({"stroke": 0.3}, {"notouch": 0.9}, False),
    ],
)
def test_a_gesture_changes_only_on_clear_evidence(
    at_final: dict[str, float], lately: dict[str, float], changed: bool
) -> None:
    decision = Decision(DecisionSettings(), LABELS)
    decision.answer("final", probabilities(**at_final))
    assert decision.has_changed(probabilities(**lately)) == changed
