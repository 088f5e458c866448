"""Which answers trigger which actions, and how they are configured."""

import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml
from rigs.made_events import PREDICTION

from touchd.daemon.app.config import Language, Words
from touchd.daemon.path.feel import Feel
from touchd.daemon.robot import actions
from touchd.daemon.robot.actions import MEASURES, Action, ActionRule
from touchd.daemon.robot.reactions import MOST_TOUCHES, Choice, Reactions, spoken
from touchd.daemon.robot.words import vocabulary
from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.robot.acting import Act
from touchd.model.classifier import Classifier

Rules = tuple[ActionRule, ...]


def rules(text: str) -> Rules:
    return msgspec.convert(yaml.safe_load(text), Rules)


def done(chosen: Choice, gesture: str, touch: int = 1, now_s: float = 0.0, **other: Any) -> list[str]:
    """Return what the robot says to an answer."""
    answer = msgspec.structs.replace(PREDICTION, gesture=gesture, touch=touch, **other)
    return [str(action.say) for action in chosen.actions(answer, now_s)]


def test_the_rules_in_the_example_are_valid() -> None:
    example = (Path(actions.__file__).parents[1] / "touchd.example.yaml").read_text()
    rules = re.sub(
        r"^( *)#(?! )", r"\1", example[example.index("  #actions:") :].partition("\n\n")[0], flags=re.M
    )
    first, second, blow = msgspec.convert(yaml.safe_load(rules)["actions"], Rules)
    assert first.do[0].leds == "green"
    assert first.refractory_s == 5
    assert second.changed
    assert (blow.gestures, blow.above) == (("other",), {"peak": 300})


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[{}]", "missing required field `do`"),
        ("[{do: []}]", "length >= 1"),
        ("[{do: [{}]}]", "exactly one of say, animated_say, behavior, leds; here: none"),
        ("[{do: [{say: a, behavior: b}]}]", "here: say, behavior"),
        ("[{do: [{shout: a}]}]", "unknown field `shout`"),
        ("[{do: [{say: '{gestur}'}]}]", "may hold {gesture}, {name}, {phrase} and {confidence}"),
        ("[{do: [{say: '{gesture.__class__}'}]}]", "may hold {gesture}, {name}, {phrase} and {confidence}"),
        ("[{do: [{say: '{confidence:.3f}'}]}]", "may hold {gesture}, {name}, {phrase} and {confidence}"),
        ("[{do: [{say: 'a {'}]}]", "write {{ for a brace"),
        ("[{do: [{leds: pink}]}]", "'pink' is neither #rrggbb nor one of white, red"),
        ("[{do: [{leds: '#00ff0080'}]}]", "'#00ff0080' is neither #rrggbb nor"),
        ("[{do: [{say: a}], stages: [middle]}]", "Invalid enum value 'middle'"),
        ("[{do: [{say: a}], refractory_s: -1}]", ">= 0"),
        ("[{do: [{say: a}], stages: [uncertain]}]", "never acts: uncertain is told at stage uncertain"),
        ("[{do: [{say: a}], stages: [uncertain], gestures: [pat]}]", "never acts"),
        ("[{do: [{say: a}], stages: [final], gestures: [uncertain]}]", "never acts"),
    ],
)
def test_a_wrong_rule_is_refused_with_the_reason(text: str, complaint: str) -> None:
    with pytest.raises(msgspec.ValidationError) as error:
        rules(text)
    assert complaint in str(error.value)


def test_a_confidence_is_spoken_in_whole_percent() -> None:
    assert Action(say="{{{gesture}}} {confidence}").say is not None
    assert spoken("{{{gesture}}} {confidence}", "pat", 0.994, {}) == "{pat} 99"


def test_the_robot_speaks_with_the_gestures_phrases() -> None:
    says = "{name}: that feels like {phrase}."
    assert spoken(says, "pat", 1.0, vocabulary("en", {})) == "pat: that feels like a pat."
    assert spoken(says, "tickle", 1.0, vocabulary("en", {})) == "tickle: that feels like tickling."
    assert spoken("Das war {phrase}.", "pat", 1.0, vocabulary("de", {})) == "Das war Tätscheln."
    own = {"pat": Words(name="tap", phrase="a tap")}
    assert spoken(says, "pat", 1.0, vocabulary("en", own)) == "tap: that feels like a tap."
    assert spoken(says, "poke", 1.0, vocabulary("en", own)) == "poke: that feels like poke."


@pytest.mark.parametrize("language", ["en", "de"])
def test_every_answer_of_the_model_has_words(language: Language) -> None:
    assert {*Classifier.load().labels, "uncertain"} <= vocabulary(language, {}).keys()


def test_a_rule_without_stages_fires_on_changes_only() -> None:
    chosen = Choice(rules("[{do: [{say: any}]}]"))
    assert done(chosen, "stroke", 1, stage="early") == ["any"]
    assert done(chosen, "stroke", 1, stage="final") == []
    assert done(chosen, "pat", 1, stage="ongoing") == ["any"]
    assert done(chosen, "pat", 2, stage="early") == ["any"]


def test_a_rule_with_stages_fires_once_an_answer() -> None:
    chosen = Choice(rules("[{do: [{say: any}], stages: [early, final, ongoing]}]"))
    stages = ["early", "revised", "final"]
    assert [done(chosen, "stroke", 1, stage=stage) for stage in stages] == [["any"], [], []]
    assert done(chosen, "pat", 1, stage="ongoing") == ["any"]


@pytest.mark.parametrize("settled", ["final", "released"])
def test_the_settled_answer_triggers_once_even_if_told_early(settled: str) -> None:
    chosen = Choice(rules("[{do: [{say: settled}], stages: [final, released]}]"))
    assert done(chosen, "stroke", 1, stage="early") == []
    assert done(chosen, "stroke", 1, stage=settled, told=False) == ["settled"]
    assert done(chosen, "rub", 2, stage=settled) == ["settled"]
    assert done(chosen, "notouch", 3, stage=settled, told=False) == []


def test_simultaneous_touches_are_kept_apart() -> None:
    chosen = Choice(rules("[{do: [{say: any}]}]"))
    assert [done(chosen, "stroke", touch) for touch in (1, 2, 1, 2)] == [["any"], ["any"], [], []]


def test_only_the_latest_touches_are_remembered() -> None:
    chosen = Choice(rules("[{do: [{say: any}]}]"))
    assert all(done(chosen, "stroke", touch) == ["any"] for touch in range(2 * MOST_TOUCHES))
    for touch in range(MOST_TOUCHES, 2 * MOST_TOUCHES):
        assert done(chosen, "stroke", touch) == []
    assert done(chosen, "stroke", MOST_TOUCHES - 1) == ["any"]


def test_a_rule_with_gestures_applies_to_these_only() -> None:
    chosen = Choice(rules("[{do: [{say: soft}], gestures: [stroke, tickle]}]"))
    gestures = ["stroke", "pat", "tickle"]
    assert [done(chosen, g, touch) for touch, g in enumerate(gestures)] == [["soft"], [], ["soft"]]


def test_a_gesture_of_ones_own_triggers_a_rule_for_all() -> None:
    chosen = Choice(rules("[{do: [{say: any}]}]"))
    assert [done(chosen, own, touch) for touch, own in enumerate(("bump", "wave"))] == [["any"], ["any"]]


def test_a_rule_for_a_blow_needs_other_and_its_strength() -> None:
    chosen = Choice(
        rules("[{do: [{say: thanks}]}, {do: [{say: Ouch}], gestures: [other], above: {peak: 300}}]")
    )
    poked = Feel(**dict.fromkeys(MEASURES, 0.0))
    struck = msgspec.structs.replace(poked, peak=600.0)
    assert done(chosen, "other", 1, feel=struck) == ["Ouch"]
    assert done(chosen, "other", 2, feel=poked) == []
    assert done(chosen, "pat", 3, feel=struck) == ["thanks"]


def test_uncertain_triggers_only_a_rule_that_names_it() -> None:
    chosen = Choice(rules("[{do: [{say: any}]}, {do: [{say: hm}], gestures: [uncertain]}]"))
    assert done(chosen, "uncertain", 1, stage="uncertain") == ["hm"]


def test_a_changed_answer_can_have_an_action_of_its_own() -> None:
    chosen = Choice(
        rules(
            "[{do: [{say: a tickle}], gestures: [tickle]},"
            " {do: [{say: 'oh, a tickle'}], gestures: [tickle], changed: true},"
            " {do: [{say: a pat}], gestures: [pat]}]"
        )
    )
    assert done(chosen, "tickle", 1) == ["a tickle"]
    assert done(chosen, "stroke", 2) == []
    assert done(chosen, "tickle", 2) == ["oh, a tickle"]
    assert done(chosen, "pat", 2) == ["a pat"]


def test_every_matching_rule_is_carried_out_in_order() -> None:
    chosen = Choice(
        rules("[{do: [{say: one}, {say: two}]}, {do: [{say: never}], gestures: [rub]}, {do: [{say: three}]}]")
    )
    assert done(chosen, "pat", 1) == ["one", "two", "three"]


def test_a_rule_rests_for_its_refractory_time() -> None:
    chosen = Choice(rules("[{do: [{say: slow}], refractory_s: 5}, {do: [{say: quick}]}]"))
    times = [0.0, 4.9, 5.1]
    assert [done(chosen, "pat", touch, now_s=now) for touch, now in enumerate(times)] == [
        ["slow", "quick"],
        ["quick"],
        ["slow", "quick"],
    ]


def test_every_kind_of_action_reaches_the_robot_in_order() -> None:
    rule = ActionRule(
        do=(
            Action(leds="#ff8000"),
            Action(animated_say="A {gesture}!"),
            Action(behavior="animations/Stand/Gestures/Hey_1"),
            Action(say="I am {confidence} percent sure"),
        )
    )
    acts: list[Act] = []
    begun: list[tuple[str, str]] = []
    rules = {DEFAULT_PAD: (rule,)}
    reactions = Reactions(rules, {}, acts.extend, lambda _, kind, what: begun.append((kind, what)))
    reactions.on_answer(msgspec.structs.replace(PREDICTION, gesture="tickle", confidence=0.654))
    assert [(act.service, act.arguments) for act in acts] == [
        ("ALLeds", ("FaceLeds", 0xFF8000, 0.3)),
        ("ALAnimatedSpeech", ("A tickle!",)),
        ("ALBehaviorManager", ("animations/Stand/Gestures/Hey_1",)),
        ("ALTextToSpeech", ("I am 65 percent sure",)),
    ]
    for act in acts:
        act.on_begin()
    assert begun == [
        ("leds", "#ff8000"),
        ("animated_say", "A tickle!"),
        ("behavior", "animations/Stand/Gestures/Hey_1"),
        ("say", "I am 65 percent sure"),
    ]
