"""The link to a Nao: answers become events in its memory and, if configured, actions.

The daemon never waits for the robot, whether that is there, hangs or refuses.
"""

import atexit
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.robot.actions import ActionRule, Kind, Words
from touchd.drivers.robot.events import EventWorker
from touchd.drivers.robot.limits import RobotLimits
from touchd.drivers.robot.message import RobotMessage
from touchd.drivers.robot.reactions import Reactions, ReactionWorker
from touchd.drivers.robot.session import OpenSession, QiSession, RobotError, RobotSession, load_qi
from touchd.drivers.robot.settings import RobotSettings, read_login, read_token
from touchd.drivers.robot.worker import LinkState

log = logging.getLogger(__name__)

NO_ACTIONS: Mapping[str, Sequence[ActionRule]] = {DEFAULT_PAD: ()}
NO_WORDS: Mapping[str, Words] = {}


class RobotLink:
    """Tells a robot what was felt.

    Two workers, each with a session of its own: one raises events, the other (only if there are actions) has
    the robot speak, move and shine, which takes seconds and must not delay an event.
    settings: checked here; raises RobotError with one line when the user must change something.
    on_state: called from a worker's thread when the robot comes ("up", "") or goes ("down", why).
    open_session: how to reach the robot, real qi when left out.
    on_act: called from a worker's thread when the robot begins to speak, move or shine, with what and how.
    actions: what the robot does on an answer, for each pad; every rule is looked at for every message. words:
    of the gestures, for what it says.
    """

    def __init__(
        self,
        settings: RobotSettings,
        on_state: Callable[[LinkState, str], None] | None = None,
        open_session: OpenSession | None = None,
        on_act: Callable[[RobotMessage, Kind, str], None] | None = None,
        *,
        actions: Mapping[str, Sequence[ActionRule]] = NO_ACTIONS,
        words: Mapping[str, Words] = NO_WORDS,
        limits: RobotLimits | None = None,
    ) -> None:
        self._settings, self._login = settings, read_login(settings)
        if open_session is None:
            load_qi()
        self._open_session = open_session or QiSession
        self._limits = limits or RobotLimits(call_s=settings.call_s, action_s=settings.action_s)
        self._on_state = on_state
        self._down_since_s: float | None = None
        self._events = EventWorker(settings.prefix, actions, self._open, self._limits, self._tell)
        self._reactions = {pad: Reactions(own) for pad, own in actions.items()}
        self._actions: ReactionWorker | None = None
        self._workers: list[EventWorker | ReactionWorker] = [self._events]
        if any(actions.values()):
            self._actions = ReactionWorker(words, on_act or (lambda *_: None), self._open, self._limits)
            self._workers.append(self._actions)

    @property
    def counts(self) -> Counter[str]:
        """What became of the messages published."""
        return self._events.counts

    def start(self) -> None:
        """Begin to connect; returns at once, and the link keeps trying until it is stopped."""
        # A Python that ends while a thread is inside libqi crashes, which must not hide why it ended.
        atexit.register(self.stop)
        for worker in self._workers:
            worker.start()

    def publish(self, message: RobotMessage, *, is_told: bool = True) -> None:
        """Act on an answer, and tell the robot if `is_told`. Never waits; call it from one thread."""
        if is_told:
            self._events.put(message)
        reaction = self._reactions[message.pad].choose(message, time.monotonic(), is_told=is_told)
        if reaction is not None and self._actions is not None:
            self._actions.put(reaction)

    def set_status(self, status: str, pad: str = DEFAULT_PAD) -> None:
        """Tell the robot whether a pad can be felt: "up", "degraded" or, while away, "down". Never waits."""
        self._events.set_status(status, pad)

    def stop(self, timeout_s: float = 2.0) -> None:
        """Say goodbye to the robot and end, in whatever state it is; may be called again."""
        deadline_s = time.monotonic() + timeout_s
        for worker in self._workers:
            worker.ask_to_stop()
        for worker in self._workers:
            if not worker.join(max(0.0, deadline_s - time.monotonic())):
                log.warning("the link to the robot did not end within %g s", timeout_s)
        atexit.unregister(self.stop)

    def _open(self, stopping: threading.Event) -> RobotSession:
        if self._login is not None:
            # The token may have been corrected since.
            with suppress(RobotError):
                self._login = replace(self._login, token=read_token(self._settings))
        return self._open_session(self._settings.url, self._login, self._limits, stopping)

    def _tell(self, state: LinkState, reason: str) -> None:
        now_s = time.monotonic()
        if state == "down":
            self._down_since_s = now_s
            log.warning("robot %s is down (%s); trying until it is there", self._settings.url, reason)
        elif self._down_since_s is None:
            log.info("robot %s is up", self._settings.url)
        else:
            log.info("robot %s is up again after %.1f s", self._settings.url, now_s - self._down_since_s)
        if self._on_state is not None:
            self._on_state(state, reason)
