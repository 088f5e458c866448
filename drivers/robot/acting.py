"""Chooses the rules that an answer triggers, and has the robot carry out their actions."""

import logging
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from touchd.drivers.robot.reactions import UNCERTAIN, Action, ActionRule, Kind, RobotMessage, Words
from touchd.drivers.robot.session import RobotLimits, RobotLost, RobotRefused, RobotSession
from touchd.drivers.robot.worker import Worker

log = logging.getLogger(__name__)

# Touches that are remembered: more than can go on at once.
MOST_TOUCHES = 64


@dataclass
class _Reported:
    """The last answer to a touch that the robot was sent, and the rules that this answer has set off."""

    gesture: str | None = None
    rules: set[int] = field(default_factory=set)


@dataclass(frozen=True)
class Reaction:
    """Actions to carry out in order, for one answer."""

    message: RobotMessage
    actions: tuple[Action, ...]


class Reactions:
    """Chooses the rules that an answer sets off; remembers the last answer of each recent touch."""

    def __init__(self, rules: Sequence[ActionRule]) -> None:
        self._rules = tuple(rules)
        self._ready_s = [float("-inf")] * len(self._rules)
        self._reported: OrderedDict[int, _Reported] = OrderedDict()

    def choose(self, message: RobotMessage, now_s: float, *, is_told: bool = True) -> Reaction | None:
        """Return the actions for an answer, None without any. now_s: any clock that never goes back.

        is_told: whether the robot is sent this answer. One that is not sent counts only where it confirms the
        answer sent before, at another stage.
        """
        last = self._reported.setdefault(message.touch, _Reported())
        if len(self._reported) > MOST_TOUCHES:
            self._reported.popitem(last=False)
        before = last.gesture
        news = message.gesture != before
        if news and not is_told:
            return None
        if news:
            last.gesture, last.rules = message.gesture, set()
        fitting = {index: rule for index, rule in enumerate(self._rules) if _fits(rule, message, news)}
        is_change = news and before is not None and any(rule.changed for rule in fitting.values())
        actions: list[Action] = []
        for index, rule in fitting.items():
            if rule.changed == is_change and now_s >= self._ready_s[index] and index not in last.rules:
                self._ready_s[index] = now_s + rule.refractory_s
                last.rules.add(index)
                actions += rule.do
        return Reaction(message, tuple(actions)) if actions else None


def _fits(rule: ActionRule, message: RobotMessage, news: bool) -> bool:
    named = message.gesture in rule.gestures if rule.gestures else message.gesture != UNCERTAIN
    # A measure that this touch does not have is neither high nor low.
    measured = {measure: value for measure, value in message.feel.items() if value is not None}
    is_like = all(measured.get(measure, -math.inf) >= least for measure, least in rule.above.items())
    is_like &= all(measured.get(measure, math.inf) < most for measure, most in rule.below.items())
    return named and is_like and (message.stage in rule.stages if rule.stages else news)


def spoken(template: str, gesture: str, confidence: float, words: Mapping[str, Words]) -> str:
    """Fill in the gesture, its words where it has any, and the confidence (0 to 1) in whole percent."""
    called = words.get(gesture) or Words(name=gesture, phrase=gesture)
    return template.format(
        gesture=gesture, name=called.name, phrase=called.phrase, confidence=round(100 * confidence)
    )


class ReactionWorker(Worker[Reaction]):
    """Carries reactions out, one action after the other, each to its end.

    actions: the rules of each pad. words: of the gestures, for speech. on_act: called as an action begins,
    with its words or name.
    """

    def __init__(
        self,
        actions: Mapping[str, Sequence[ActionRule]],
        words: Mapping[str, Words],
        on_act: Callable[[RobotMessage, Kind, str], None],
        open_session: Callable[[threading.Event], RobotSession],
        limits: RobotLimits,
    ) -> None:
        # Pass no on_state: the worker that raises events reports whether the robot is there.
        super().__init__("touchd-robot-actions", open_session, limits)
        self._chosen = {pad: Reactions(rules) for pad, rules in actions.items()}
        self._words = words
        self._on_act = on_act

    def react(self, message: RobotMessage, *, is_told: bool) -> None:
        """Queue what an answer triggers, if anything; returns at once. Call it from one thread."""
        reaction = self._chosen[message.pad].choose(message, time.monotonic(), is_told=is_told)
        if reaction is not None:
            self.put(reaction)

    def handle(self, session: RobotSession, item: Reaction) -> None:
        """Carry out a reaction; refused actions are skipped, and raised as RobotRefused at the end."""
        refused: list[RobotRefused] = []
        for left, action in zip(range(len(item.actions) - 1, -1, -1), item.actions, strict=True):
            try:
                self._perform(session, action, item.message)
            except RobotRefused as error:
                refused.append(error)
            except RobotLost as lost:
                log.warning("an action is given up, with %d after it: %s", left, lost)
                raise
        if refused:
            raise RobotRefused("; ".join(map(str, refused)))

    def _perform(self, session: RobotSession, action: Action, message: RobotMessage) -> None:
        """Have the robot do one action and wait for its end; raises RobotLost or RobotRefused."""

        def call(kind: Kind, what: str, service: str, method: str, *arguments: object) -> None:
            self._on_act(message, kind, what)
            session.call(service, method, *arguments, limit_s=self._limits.action_s)

        if action.say is not None:
            words = spoken(action.say, message.gesture, message.confidence, self._words)
            call("say", words, "ALTextToSpeech", "say", words)
        elif action.animated_say is not None:
            words = spoken(action.animated_say, message.gesture, message.confidence, self._words)
            call("animated_say", words, "ALAnimatedSpeech", "say", words)
        elif action.behavior is not None:
            call("behavior", action.behavior, "ALBehaviorManager", "runBehavior", action.behavior)
        elif action.leds is not None:
            leds = action.leds
            call("leds", leds.color, "ALLeds", "fadeRGB", leds.group, leds.rgb, leds.fade_s)
