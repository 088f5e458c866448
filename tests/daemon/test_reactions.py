"""Which answers trigger which actions, how they are configured, and the words for gestures."""

import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml
from rigs.made_events import PREDICTION

from touchd.daemon.app.config import Language, Settings, Words
from touchd.daemon.path.events import Event, RobotAction
from touchd.daemon.path.feel import Feel
from touchd.daemon.robot import actions
from touchd.daemon.robot.actions import MEASURES, Action, ActionRule
from touchd.daemon.robot.reactions import MOST_TOUCHES, Reactions, act_of, spoken
from touchd.daemon.robot.words import SHIPPED, words_of
from touchd.model.classifier import Classifier

Rules = tuple[ActionRule, ...]
GENTLE = Feel(**dict.fromkeys(MEASURES, 0.0))


def rules(text: str) -> Rules:
    return msgspec.convert(yaml.safe_load(text), Rules)


def done(chosen: Reactions, gesture: str, touch: int = 1, now_s: float = 0.0, **other: Any) -> list[str]:
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
        ("[{do: []}]", "length >= 1"),
        ("[{do: [{}]}]", "exactly one of say, animated_say, behavior, leds; here: none"),
        ("[{do: [{say: a, behavior: b}]}]", "here: say, behavior"),
        ("[{do: [{shout: a}]}]", "unknown field `shout`"),
        ("[{do: [{say: '{gestur}'}]}]", "may hold {gesture}, {name}, {phrase} and {confidence}"),
        ("[{do: [{say: '{gesture.__class__}'}]}]", "may hold {gesture}, {name}, {phrase} and {confidence}"),
        ("[{do: [{say: 'a {'}]}]", "write {{ for a brace"),
        ("[{do: [{leds: pink}]}]", "'pink' is neither #rrggbb nor one of white, red"),
        ("[{do: [{leds: '#00ff0080'}]}]", "'#00ff0080' is neither #rrggbb nor"),
        ("[{do: [{say: a}], stages: [uncertain]}]", "never acts: uncertain is told at stage uncertain"),
        ("[{do: [{say: a}], stages: [uncertain], gestures: [pat]}]", "never acts"),
        ("[{do: [{say: a}], stages: [final], gestures: [uncertain]}]", "never acts"),
    ],
)
def test_a_wrong_rule_is_refused_with_the_reason(text: str, complaint: str) -> None:
    with pytest.raises(msgspec.ValidationError) as error:
        rules(text)
    assert complaint in str(error.value)


OWN = {"pat": Words(name="tap", phrase="a tap")}
ENGLISH = words_of(Settings())
FEELS = "{name}: that feels like {phrase}."


@pytest.mark.parametrize(
    ("template", "gesture", "words", "said"),
    [
        ("{{{gesture}}} {confidence}", "pat", {}, "{pat} 99"),
        (FEELS, "pat", ENGLISH, "pat: that feels like a pat."),
        (FEELS, "tickle", ENGLISH, "tickle: that feels like tickling."),
        ("Das war {phrase}.", "pat", words_of(Settings(language="de")), "Das war Tätscheln."),
        (FEELS, "pat", words_of(Settings(words=OWN)), "tap: that feels like a tap."),
        (FEELS, "poke", words_of(Settings(words=OWN)), "poke: that feels like poke."),
    ],
)
def test_words_are_filled_in(template: str, gesture: str, words: dict[str, Words], said: str) -> None:
    assert Action(say=template).say is not None
    assert spoken(template, gesture, 0.994, words) == said


@pytest.mark.parametrize("language", ["en", "de"])
def test_every_answer_of_the_model_has_words(language: Language) -> None:
    assert {*Classifier.load().labels, "uncertain"} <= words_of(Settings(language=language)).keys()


ANY = "[{do: [{say: any}]}]"
# A rule, and answers with what the robot says to each: gesture, touch, stage, whatever else, what is said.
FIRES = {
    "without stages, whenever the answer is news": (
        ANY,
        ["stroke 1 early: any", "stroke 1 final:", "pat 1 ongoing: any", "pat 2 early: any"],
    ),
    "with stages, once an answer": (
        "[{do: [{say: any}], stages: [early, final, ongoing]}]",
        ["stroke 1 early: any", "stroke 1 revised:", "stroke 1 final:", "pat 1 ongoing: any"],
    ),
    "on the settled answer, also if told early": (
        "[{do: [{say: settled}], stages: [final, released]}]",
        [
            *(
                "stroke 1 early:",
                "stroke 1 final untold: settled",
                "pat 2 early:",
                "pat 2 released untold: settled",
            ),
            *("rub 3 final: settled", "rub 4 released: settled", "notouch 5 final untold:"),
        ],
    ),
    "for each of simultaneous touches": (
        ANY,
        ["stroke 1 early: any", "stroke 2 early: any", "stroke 1 early:", "stroke 2 early:"],
    ),
    "for its gestures only": (
        "[{do: [{say: soft}], gestures: [stroke, tickle]}]",
        ["stroke 1 early: soft", "pat 2 early:", "tickle 3 early: soft"],
    ),
    "for a gesture of one's own": (ANY, ["bump 1 early: any", "wave 2 early: any"]),
    "for other only if named, by its strength": (
        "[{do: [{say: thanks}]}, {do: [{say: Ouch}], gestures: [other], above: {peak: 300}}]",
        ["other 1 early peak=600: Ouch", "other 2 early peak=0:", "pat 3 early peak=600: thanks"],
    ),
    "for uncertain only if named": (
        "[{do: [{say: any}]}, {do: [{say: hm}], gestures: [uncertain]}]",
        ["uncertain 1 uncertain: hm"],
    ),
    "on a changed answer if it says so": (
        "[{do: [{say: tickle}], gestures: [tickle]}, {do: [{say: oh}], gestures: [tickle], changed: true},"
        " {do: [{say: pat}], gestures: [pat]}]",
        ["tickle 1 early: tickle", "stroke 2 early:", "tickle 2 revised: oh", "pat 2 final: pat"],
    ),
    "with every other that fits, in order": (
        "[{do: [{say: one}, {say: two}]}, {do: [{say: never}], gestures: [rub]}, {do: [{say: three}]}]",
        ["pat 1 early: one two three"],
    ),
    "not within its refractory time": (
        "[{do: [{say: slow}], refractory_s: 5}, {do: [{say: quick}]}]",
        ["pat 1 early at=0: slow quick", "pat 2 early at=4.9: quick", "pat 3 early at=5.1: slow quick"],
    ),
}


@pytest.mark.parametrize(("text", "answers"), FIRES.values(), ids=list(FIRES))
def test_a_rule_fires(text: str, answers: list[str]) -> None:
    chosen = Reactions(rules(text))
    for line in answers:
        answer, _, said = line.partition(":")
        gesture, touch, stage, *others = answer.split()
        other = dict(each.split("=") for each in others if "=" in each)
        feel = msgspec.structs.replace(GENTLE, peak=float(other.get("peak", 0)))
        options = {"stage": stage, "told": "untold" not in others, "feel": feel}
        assert done(chosen, gesture, int(touch), float(other.get("at", 0)), **options) == said.split(), line


def test_only_the_latest_touches_are_remembered() -> None:
    chosen = Reactions(rules("[{do: [{say: any}]}]"))
    assert all(done(chosen, "stroke", touch) == ["any"] for touch in range(2 * MOST_TOUCHES))
    for touch in range(MOST_TOUCHES, 2 * MOST_TOUCHES):
        assert done(chosen, "stroke", touch) == []
    assert done(chosen, "stroke", MOST_TOUCHES - 1) == ["any"]


def test_every_kind_of_action_reaches_the_robot_in_order() -> None:
    rule = ActionRule(
        do=(
            Action(leds="#ff8000"),
            Action(animated_say="A {gesture}!"),
            Action(behavior="animations/Stand/Gestures/Hey_1"),
            Action(say="I am {confidence} percent sure"),
        )
    )
    begun: list[Event] = []
    answer = msgspec.structs.replace(PREDICTION, gesture="tickle", confidence=0.654)
    acts = [act_of(action, answer, {}, begun.append) for action in rule.do]
    assert [(act.service, act.arguments) for act in acts] == [
        ("ALLeds", ("FaceLeds", 0xFF8000, 0.3)),
        ("ALAnimatedSpeech", ("A tickle!",)),
        ("ALBehaviorManager", ("animations/Stand/Gestures/Hey_1",)),
        ("ALTextToSpeech", ("I am 65 percent sure",)),
    ]
    for act in acts:
        act.on_begin()
    assert [(one.action, one.what) for one in begun if isinstance(one, RobotAction)] == [
        ("leds", "#ff8000"),
        ("animated_say", "A tickle!"),
        ("behavior", "animations/Stand/Gestures/Hey_1"),
        ("say", "I am 65 percent sure"),
    ]


def test_every_language_names_the_same_gestures() -> None:
    assert len({frozenset(words) for words in SHIPPED.values()}) == 1
