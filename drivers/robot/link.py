"""The link to a Nao: what was felt becomes events in its memory and, if wanted, things it does.

The daemon hands messages over and goes on; whether the robot is there, hangs or refuses never reaches it.
"""

from __future__ import annotations

import atexit
import logging
import os
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Event

from drivers.frame import DEFAULT_PAD
from drivers.robot.actions import ActionRule, Kind, Words
from drivers.robot.events import EventDuty
from drivers.robot.limits import RobotLimits
from drivers.robot.message import RobotMessage
from drivers.robot.reactions import Reaction, ReactionDuty, Reactions
from drivers.robot.session import Login, OpenSession, QiSession, RobotError, RobotSession, load_qi
from drivers.robot.worker import RobotCounts, RobotWorker, State

__all__ = ["RobotCounts", "RobotError", "RobotLimits", "RobotLink", "RobotMessage", "RobotSettings", "State"]

log = logging.getLogger(__name__)

MAX_TOKEN_BYTES = 4096


@dataclass(frozen=True, kw_only=True)
class RobotSettings:
    """Where the robot is, how to log in, and what it does.

    url: tcp://host:9559 for NAOqi up to 2.8, tcps://host:9503 for 2.9. libqi encrypts the latter, but checks
    no certificate. prefix: of the events' names.
    user, and one of token_file and token_env (a file, or an environment variable, that holds the token): for
    NAOqi 2.9, which asks.
    actions: what the robot does on an answer; every rule is looked at for every message. words: of the
    gestures, for what it says.
    pads: the actions for each pad that has a name; empty where the only pad has none.
    """

    url: str
    prefix: str = "TouchGesture"
    user: str | None = None
    token_file: str | None = None
    token_env: str | None = None
    actions: tuple[ActionRule, ...] = ()
    pads: Mapping[str, tuple[ActionRule, ...]] = field(default_factory=dict)
    words: Mapping[str, Words] = field(default_factory=dict)
    limits: RobotLimits = field(default_factory=RobotLimits)


class RobotLink:
    """Tells a robot what was felt.

    Two workers, each with a session of its own: one raises events, the other (only if there are actions) has
    the robot speak, move and shine, which takes seconds and must not delay an event.
    settings: checked here; raises RobotError with one line when the user must change something.
    on_state: called from a worker's thread when the robot comes ("up", "") or goes ("down", why).
    open_session: how to reach the robot, real qi when left out.
    on_act: called from a worker's thread when the robot begins to speak, move or shine, with what and how.
    """

    def __init__(
        self,
        settings: RobotSettings,
        on_state: Callable[[State, str], None] | None = None,
        open_session: OpenSession | None = None,
        on_act: Callable[[RobotMessage, Kind, str], None] | None = None,
    ) -> None:
        login = read_login(settings)
        if open_session is None:
            load_qi()
            open_session = QiSession
        limits = settings.limits
        opener = partial(_open, open_session, settings.url, login, limits)
        self._url = settings.url
        self._on_state = on_state
        self._down_since_s: float | None = None
        rules = settings.pads or {DEFAULT_PAD: settings.actions}
        self._event_duty = EventDuty(settings.prefix, limits, rules)
        self._events: RobotWorker[RobotMessage] = RobotWorker(
            "touchd-robot", opener, self._event_duty, limits, self._tell
        )
        self._reactions = {pad: Reactions(own) for pad, own in rules.items()}
        self._actions: RobotWorker[Reaction] | None = None
        if any(rules.values()):
            self._actions = RobotWorker(
                "touchd-robot-actions",
                opener,
                ReactionDuty(limits, settings.words, on_act or _tell_nobody),
                limits,
                _say_nothing,
            )

    @property
    def counts(self) -> RobotCounts:
        """What became of the messages published."""
        return self._events.counts

    @property
    def action_counts(self) -> RobotCounts:
        """What became of the reactions, one for each message that set any rule off."""
        return self._actions.counts if self._actions else RobotCounts()

    def start(self) -> None:
        """Begin to connect; returns at once, and the link keeps trying until it is stopped."""
        # A Python that ends while a thread is inside libqi crashes, which must not hide why it ended.
        atexit.register(self.stop)
        for worker in self._workers():
            worker.start()

    def publish(self, message: RobotMessage) -> None:
        """Tell the robot one answer. Never waits for the robot; call it from one thread."""
        self._events.put(message)
        self._act(message, is_told=True)

    def settle(self, message: RobotMessage) -> None:
        """Act on an answer at which the robot is told nothing new. Never waits; from the same thread."""
        self._act(message, is_told=False)

    def _act(self, message: RobotMessage, *, is_told: bool) -> None:
        reaction = self._reactions[message.pad].choose(message, time.monotonic(), is_told=is_told)
        if reaction is not None and self._actions is not None:
            self._actions.put(reaction)

    def set_status(self, status: State, pad: str = DEFAULT_PAD) -> None:
        """Tell the robot whether touches can be felt on a pad: "down" while it is away. Never waits."""
        self._event_duty.status[pad] = status
        self._events.wake()

    def stop(self, timeout_s: float = 2.0) -> None:
        """Say goodbye to the robot and end, in whatever state it is; may be called again."""
        deadline_s = time.monotonic() + timeout_s
        for worker in self._workers():
            worker.ask_to_stop()
        for worker in self._workers():
            if not worker.join(max(0.0, deadline_s - time.monotonic())):
                log.warning("the link to the robot did not end within %g s", timeout_s)
        atexit.unregister(self.stop)

    def _workers(self) -> list[RobotWorker[RobotMessage] | RobotWorker[Reaction]]:
        return [self._events, *([self._actions] if self._actions else [])]

    def _tell(self, state: State, reason: str) -> None:
        now_s = time.monotonic()
        if state == "down":
            self._down_since_s = now_s
            log.warning("robot %s is down (%s); trying until it is there", self._url, reason)
        elif self._down_since_s is None:
            log.info("robot %s is up", self._url)
        else:
            log.info("robot %s is up again after %.1f s", self._url, now_s - self._down_since_s)
        if self._on_state is not None:
            self._on_state(state, reason)


def read_login(settings: RobotSettings) -> Login | None:
    """Return whom to log in as, None where no user is set; raises RobotError with one line.

    The token comes from a file or an environment variable, and is in no text made of the result.
    """
    if not re.fullmatch(r"tcps?://[^\s/@:]+:\d+", settings.url):
        raise RobotError(f"robot url {settings.url!r} is not an address such as tcp://nao.local:9559")
    if settings.user is None:
        if settings.token_file or settings.token_env:
            raise RobotError("robot has a token but no user; set user (nao on most robots)")
        return None
    if not settings.url.startswith("tcps://"):
        raise RobotError(
            f"robot {settings.url} would get the token unencrypted; use tcps://, or leave user out"
        )
    return Login(settings.user, _read_token(settings))


def _read_token(settings: RobotSettings) -> str:
    if settings.token_file is not None:
        where = settings.token_file
        try:
            with Path(where).expanduser().open("rb") as file:
                content = file.read(MAX_TOKEN_BYTES + 1)
            token = content.decode().strip()
        except (OSError, UnicodeDecodeError) as error:
            why = error.strerror if isinstance(error, OSError) else "not text"
            raise RobotError(f"robot token_file {where} cannot be read ({why})") from error
        if len(content) > MAX_TOKEN_BYTES:
            raise RobotError(
                f"robot token_file {where} is larger than {MAX_TOKEN_BYTES} bytes, so not a token"
            )
    elif settings.token_env is not None:
        where = settings.token_env
        token = os.environ.get(where, "").strip()
    else:
        raise RobotError("robot has a user but no token; set token_file or token_env")
    if not token:
        raise RobotError(f"the robot's token in {where} is empty or missing; put it there")
    return token


def _open(
    open_session: OpenSession, url: str, login: Login | None, limits: RobotLimits, hurry: Event
) -> RobotSession:
    return open_session(url, login, limits, hurry)


def _tell_nobody(message: RobotMessage, kind: Kind, what: str) -> None:
    """For who does not want to know what the robot does."""


def _say_nothing(state: State, reason: str) -> None:
    """The worker of the events says when the robot comes and goes; twice would be a flood."""
