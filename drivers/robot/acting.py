"""Has the robot speak, run behaviours and light its LEDs."""

import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from touchd.drivers.robot.session import RobotLimits, RobotLost, RobotRefused, RobotSession
from touchd.drivers.robot.worker import Worker

log = logging.getLogger(__name__)

OnBegin = Callable[[], None]


@dataclass(frozen=True)
class Act:
    """A call that the robot carries out to its end. on_begin: called from the worker's thread before it."""

    service: str
    method: str
    arguments: tuple[object, ...]
    on_begin: OnBegin


def say(words: str, on_begin: OnBegin = lambda: None) -> Act:
    return Act("ALTextToSpeech", "say", (words,), on_begin)


def animated_say(words: str, on_begin: OnBegin = lambda: None) -> Act:
    """Speak and move along."""
    return Act("ALAnimatedSpeech", "say", (words,), on_begin)


def run_behavior(name: str, on_begin: OnBegin = lambda: None) -> Act:
    """Run an installed behaviour to its end."""
    return Act("ALBehaviorManager", "runBehavior", (name,), on_begin)


def set_leds(group: str, rgb: int, fade_s: float, on_begin: OnBegin = lambda: None) -> Act:
    """Fade a group of lights to a colour, 0xRRGGBB."""
    return Act("ALLeds", "fadeRGB", (group, rgb, fade_s), on_begin)


class ActWorker(Worker[Sequence[Act]]):
    """Carries acts out, one after the other, each to its end."""

    def __init__(self, open_session: Callable[[threading.Event], RobotSession], limits: RobotLimits) -> None:
        super().__init__("touchd-robot-actions", open_session, limits)

    def handle(self, session: RobotSession, item: Sequence[Act]) -> None:
        """Carry acts out; refused ones are skipped, and raised as RobotRefused at the end."""
        refused: list[RobotRefused] = []
        for left, act in zip(range(len(item) - 1, -1, -1), item, strict=True):
            act.on_begin()
            try:
                session.call(act.service, act.method, *act.arguments, limit_s=self._limits.action_s)
            except RobotRefused as error:
                refused.append(error)
            except RobotLost as lost:
                log.warning("an action is given up, with %d after it: %s", left, lost)
                raise
        if refused:
            raise RobotRefused("; ".join(map(str, refused)))
