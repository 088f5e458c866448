"""From an answer to what the robot does about it, and the doing of it."""

import logging
import math
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Event

from touchd.drivers.robot.actions import UNCERTAIN, Action, ActionRule, Kind, Words, spoken
from touchd.drivers.robot.limits import RobotLimits
from touchd.drivers.robot.message import RobotMessage
from touchd.drivers.robot.session import RobotLost, RobotRefused, RobotSession
from touchd.drivers.robot.worker import RobotWorker

log = logging.getLogger(__name__)

# Touches that may go on at once, with room to spare.
MOST_TOUCHES = 64


@dataclass
class _Heard:
    """What the robot has heard of a touch, and the rules that this answer has set off."""

    gesture: str | None = None
    rules: set[int] = field(default_factory=set)


@dataclass(frozen=True)
class Reaction:
    """Actions to carry out in order, for one answer."""

    message: RobotMessage
    actions: tuple[Action, ...]


class Reactions:
    """Chooses the rules that an answer sets off; remembers what the last touches were taken for."""

    def __init__(self, rules: Sequence[ActionRule]) -> None:
        self._rules = tuple(rules)
        self._ready_s = [float("-inf")] * len(self._rules)
        self._heard: OrderedDict[int, _Heard] = OrderedDict()

    def choose(self, message: RobotMessage, now_s: float, *, is_told: bool = True) -> Reaction | None:
        """Return what to do about an answer, None for nothing. now_s: any clock that never goes back.

        is_told: the robot is told this answer now. One that it is not told counts only as the settled word on
        what it has heard already.
        """
        heard = self._heard.setdefault(message.touch, _Heard())
        if len(self._heard) > MOST_TOUCHES:
            self._heard.popitem(last=False)
        before = heard.gesture
        news = message.gesture != before
        if news and not is_told:
            return None
        if news:
            heard.gesture, heard.rules = message.gesture, set()
        fitting = {index: rule for index, rule in enumerate(self._rules) if _fits(rule, message, news)}
        is_change = news and before is not None and any(rule.changed for rule in fitting.values())
        actions: list[Action] = []
        for index, rule in fitting.items():
            if rule.changed == is_change and now_s >= self._ready_s[index] and index not in heard.rules:
                self._ready_s[index] = now_s + rule.refractory_s
                heard.rules.add(index)
                actions += rule.do
        return Reaction(message, tuple(actions)) if actions else None


class ReactionWorker(RobotWorker[Reaction]):
    """Carries reactions out, one action after the other, each to its end.

    words: of the gestures, for speech. on_act: told which action begins, and with which words or name.
    """

    def __init__(
        self,
        words: Mapping[str, Words],
        on_act: Callable[[RobotMessage, Kind, str], None],
        open_session: Callable[[Event], RobotSession],
        limits: RobotLimits,
    ) -> None:
        # Whether the robot comes or goes is told by the worker that raises events.
        super().__init__("touchd-robot-actions", open_session, limits)
        self._words = words
        self._on_act = on_act

    def handle(self, session: RobotSession, item: Reaction) -> None:
        """Carry out a reaction; what the robot refuses is left out, and raised as RobotRefused at the end."""
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


def _fits(rule: ActionRule, message: RobotMessage, news: bool) -> bool:
    named = message.gesture in rule.gestures if rule.gestures else message.gesture != UNCERTAIN
    # A measure that this touch does not have is neither high nor low.
    felt = {measure: value for measure, value in message.feel.items() if value is not None}
    is_like = all(felt.get(measure, -math.inf) >= least for measure, least in rule.above.items())
    is_like &= all(felt.get(measure, math.inf) < most for measure, most in rule.below.items())
    return named and is_like and (message.stage in rule.stages if rule.stages else news)
