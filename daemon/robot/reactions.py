"""Chooses the rules that an answer triggers, and turns their actions into calls of the robot."""

import math
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import msgspec

from touchd.daemon.app.config import Words
from touchd.daemon.path.events import MAX_REASON_BYTES, UNCERTAIN, Event, Prediction, RobotAction, timestamp
from touchd.daemon.robot.actions import COLORS, Action, ActionRule
from touchd.daemon.robot.words import Vocabulary
from touchd.drivers.errors import one_line
from touchd.drivers.frame import OTHER
from touchd.drivers.robot.link import Act

# Touches that are remembered; more than can go on at once.
MOST_TOUCHES = 64
FACE, FADE_S = "FaceLeds", 0.3

# The robot's service and method for each kind of action.
METHODS: Mapping[str, tuple[str, str]] = {
    "say": ("ALTextToSpeech", "say"),
    "animated_say": ("ALAnimatedSpeech", "say"),
    "behavior": ("ALBehaviorManager", "runBehavior"),
    "leds": ("ALLeds", "fadeRGB"),
}


def act_of(action: Action, answer: Prediction, words: Vocabulary, emit: Callable[[Event], None]) -> Act:
    """Return the robot's call for an action. emit: receives an event as it begins, in the robot's thread."""
    ((kind, what),) = action.given.items()
    if kind in ("say", "animated_say"):
        what = spoken(what, answer.gesture, answer.confidence, words)
    arguments: tuple[object, ...] = (what,)
    if kind == "leds":
        arguments = (FACE, COLORS[what] if what in COLORS else int(what[1:], 16), FADE_S)

    def begins() -> None:
        now, shown = timestamp(time.time()), one_line(what, MAX_REASON_BYTES)
        emit(RobotAction(touch=answer.touch, action=kind, what=shown, time=now, pad=answer.pad))

    return Act(*METHODS[kind], arguments, begins)


@dataclass
class _Reported:
    """The last answer to a touch that the robot was sent, and the rules that this answer has triggered."""

    gesture: str | None = None
    rules: set[int] = field(default_factory=set)


class Reactions:
    """Chooses the actions for an answer on one pad; remembers the last answer of each recent touch."""

    def __init__(self, rules: Sequence[ActionRule]) -> None:
        self._rules = tuple(rules)
        self._ready_s = [float("-inf")] * len(self._rules)
        self._reported: OrderedDict[int, _Reported] = OrderedDict()

    def actions(self, answer: Prediction, now_s: float) -> list[Action]:
        """Return the actions for an answer, in order. now_s: any clock that never goes back.

        Unsent answers trigger only stage rules of the gesture that was sent.
        """
        last = self._reported.setdefault(answer.touch, _Reported())
        if len(self._reported) > MOST_TOUCHES:
            self._reported.popitem(last=False)
        before = last.gesture
        is_news = answer.gesture != before
        if is_news and not answer.told:
            return []
        if is_news:
            last.gesture, last.rules = answer.gesture, set()
        fitting = {index: rule for index, rule in enumerate(self._rules) if _fits(rule, answer, is_news)}
        is_change = is_news and before is not None and any(rule.changed for rule in fitting.values())
        actions: list[Action] = []
        for index, rule in fitting.items():
            if rule.changed == is_change and now_s >= self._ready_s[index] and index not in last.rules:
                self._ready_s[index] = now_s + rule.refractory_s
                last.rules.add(index)
                actions += rule.do
        return actions


def _fits(rule: ActionRule, answer: Prediction, is_news: bool) -> bool:
    is_named = answer.gesture in rule.gestures if rule.gestures else answer.gesture not in (OTHER, UNCERTAIN)
    # A touch without measures is neither above nor below any limit.
    measured = msgspec.structs.asdict(answer.feel) if answer.feel else {}
    is_like = all(measured.get(measure, -math.inf) >= least for measure, least in rule.above.items())
    is_like &= all(measured.get(measure, math.inf) < most for measure, most in rule.below.items())
    return is_named and is_like and (answer.stage in rule.stages if rule.stages else is_news)


def spoken(template: str, gesture: str, confidence: float, words: Vocabulary) -> str:
    """Fill in the gesture, its words where it has any, and the confidence (0 to 1) in whole percent."""
    called = words.get(gesture) or Words(name=gesture, phrase=gesture)
    return template.format(
        gesture=gesture, name=called.name, phrase=called.phrase, confidence=round(100 * confidence)
    )
