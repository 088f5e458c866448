"""The robot as a sink of events: receives told answers and the pads' states, and acts as the scene asks."""

import itertools
import time
from collections.abc import Callable, Mapping, Sequence

from touchd.daemon.app.config import Settings
from touchd.daemon.path.events import (
    MAX_REASON_BYTES,
    Event,
    Prediction,
    RobotEvent,
    SensorEvent,
    epoch_s,
    timestamp,
)
from touchd.daemon.robot.actions import ActionRule
from touchd.daemon.robot.reactions import Reactions, act_of
from touchd.daemon.robot.words import Vocabulary, words_of
from touchd.drivers.errors import one_line
from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.session import OpenSession
from touchd.drivers.robot.worker import LinkState


class RobotSink:
    """Sends told answers and the pads' states to the robot, and has it act. The link has its own threads.

    rules: of each pad, which choose the actions for every answer, told or not. words: for speech. emit:
    receives an event as an action begins, from the robot's thread.
    """

    def __init__(
        self,
        link: RobotLink,
        rules: Mapping[str, Sequence[ActionRule]] | None = None,
        words: Vocabulary | None = None,
        emit: Callable[[Event], None] = lambda _: None,
    ) -> None:
        self._link = link
        self._reactions = {pad: Reactions(of_pad) for pad, of_pad in (rules or {}).items() if of_pad}
        self._words, self._emit = words or {}, emit
        self._numbers = itertools.count(1)

    def start(self) -> None:
        self._link.start()

    def put(self, event: Event) -> None:
        """Send a told prediction to the robot, and react to any; never waits. Call it from one thread."""
        if isinstance(event, Prediction):
            if event.told:
                self._link.put(event.pad, detail_of(event, next(self._numbers)))
            reactions = self._reactions.get(event.pad)
            if reactions is not None and (actions := reactions.actions(event, time.monotonic())):
                self._link.act([act_of(action, event, self._words, self._emit) for action in actions])
        elif isinstance(event, SensorEvent):
            self._link.set_status(event.state, event.pad)

    def stop(self, timeout_s: float) -> None:
        self._link.stop(timeout_s)


def detail_of(answer: Prediction, number: int) -> list[object]:
    """Return an answer as [gesture, confidence, [seconds, microseconds], stage, touch, number].

    ALMemory holds 4-byte integers and floats. As a float an epoch time would have a resolution of 128 s, so
    it is sent as two integers. Integers wrap at 2**31.
    """
    seconds, microseconds = divmod(round(1_000_000 * epoch_s(answer.time)), 1_000_000)
    seconds, touch, number = (each & 0x7FFF_FFFF for each in (seconds, answer.touch, number))
    return [answer.gesture, answer.confidence, [seconds, microseconds], answer.stage, touch, number]


def link_to_robot(
    settings: Settings, emit: Callable[[Event], None], open_session: OpenSession | None = None
) -> RobotSink:
    """Return the link to the configured robot; raises RobotError.

    emit: receives an event when the robot comes, goes or acts, from the link's threads.
    open_session: how to reach the robot, instead of the configured client.
    """

    def report(state: LinkState, reason: str) -> None:
        why = one_line(reason, MAX_REASON_BYTES)
        emit(RobotEvent(state=state, time=timestamp(time.time()), reason=why))

    assert settings.robot is not None, "no robot is configured"
    rules = {name: pad.scene.actions for name, pad in settings.pads.items()}
    link = RobotLink(settings.robot, report, open_session, pads=rules, acts=any(rules.values()))
    for name in settings.pads:
        # Report "down" until frames come: a program that waits for "up" must not find a missing pad up.
        link.set_status("down", name)
    return RobotSink(link, rules, words_of(settings), emit)
