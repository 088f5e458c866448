"""The link to a Nao: raises answers as events in its memory, and has it act.

The daemon never waits for the robot, whether it is away, hangs or refuses.
"""

import itertools
import logging
import re
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.robot.qi_session import QiSession, load_qi
from touchd.drivers.robot.session import (
    OpenSession,
    RobotLimits,
    RobotLost,
    RobotRefused,
    RobotSession,
    RobotSettings,
)
from touchd.drivers.robot.wire import WireSession
from touchd.drivers.robot.worker import LinkState, Worker

log = logging.getLogger(__name__)

# How long PREFIX/Gesture stays in the robot's memory, as its own ALTactileGesture does.
SHOWN_S = 1.0
LIMITS = RobotLimits()


class Told(NamedTuple):
    """An answer to raise. detail: builtin types, integers of four bytes at most."""

    pad: str
    gesture: str
    detail: list[object]


@dataclass(frozen=True)
class Act:
    """A call that the robot carries out to its end. on_begin: called from the worker's thread before it."""

    service: str
    method: str
    arguments: tuple[object, ...]
    on_begin: Callable[[], None] = lambda: None


class RobotLink(Worker[Told]):
    """Sends answers to a robot and has it act.

    Raises PREFIX/Detail, then PREFIX/Gesture for each answer that is put, so that a program that wakes on the
    Gesture finds its Detail; and PREFIX/Status when it changes. For a pad with a name PREFIX/NAME/Gesture, …
    settings: checked here; raises RobotError with one line when the user must change something.
    on_state: called from the link's thread when the robot comes ("up", "") or goes ("down", why).
    open_session: how to reach the robot, instead of the configured client.
    pads: the names of those whose answers are sent. acts: whether `act` will be called.
    """

    def __init__(
        self,
        settings: RobotSettings,
        on_state: Callable[[LinkState, str], None] = lambda *_: None,
        open_session: OpenSession | None = None,
        *,
        pads: Iterable[str] = (DEFAULT_PAD,),
        acts: bool = False,
        limits: RobotLimits = LIMITS,
    ) -> None:
        opened = partial(open_session or client_of(settings), settings, limits)
        super().__init__("touchd-robot", opened, limits)
        self._url, self._prefix, self._on_state = settings.url, settings.prefix, on_state
        self._state: LinkState | None = None
        self._remove_at_s: dict[str, float] = {}
        self._sent_status: dict[str, str] = {}
        # Written by another thread, read here; replacing a value is atomic.
        self._status: dict[str, str] = dict.fromkeys(pads, "up")
        self._asked = itertools.cycle(self._status)
        # What another program last wrote instead of a pad's status.
        self._foreign: dict[str, object] = {}
        self._acts = ActWorker("touchd-robot-actions", opened, limits) if acts else None

    def start(self) -> None:
        """Begin to connect; returns at once, and the link keeps trying until it is stopped."""
        super().start()
        if self._acts is not None:
            self._acts.start()

    def act(self, acts: Sequence[Act]) -> None:
        """Have the robot carry acts out in order. Never waits; call it from one thread."""
        assert self._acts is not None, "the link was made without acts"
        self._acts.put(acts)

    def set_status(self, status: str, pad: str = DEFAULT_PAD) -> None:
        """Send the robot a pad's state: "up", "degraded" or "down". Never waits; call it from any thread."""
        self._status[pad] = status
        self._wake.set()

    def stop(self, timeout_s: float = 2.0) -> None:
        """Disconnect; idempotent."""
        deadline_s = time.monotonic() + timeout_s
        workers: list[RobotLink | ActWorker] = [self, *([self._acts] if self._acts else [])]
        for worker in workers:
            worker.ask_to_stop()
        for worker in workers:
            if not worker.join(max(0.0, deadline_s - time.monotonic())):
                log.warning("the link to the robot did not end within %g s", timeout_s)

    def note_state(self, state: LinkState, reason: str) -> None:
        """Log that the robot is there, or that an attempt to reach it failed; report a change."""
        if state == "down":
            what = f"robot {self._url} is down ({reason}); trying until it is there"
            # Durations in a reason differ from one attempt to the next.
            self._faults.begin("down", what, cause=re.sub(r"[\d.]+", "", reason))
        elif self._state is None:
            log.info("robot %s is up", self._url)
        else:
            self._faults.end("down", f"robot {self._url} is up again")
        if state != self._state:
            self._state = state
            self._on_state(state, reason)

    def begin(self, session: RobotSession) -> None:
        for pad, status in self._status.items():
            self._send_status(session, pad, status)

    def handle(self, session: RobotSession, item: Told) -> None:
        self._raise_event(session, item.pad, "Detail", item.detail)
        self._raise_event(session, item.pad, "Gesture", item.gesture)
        self._remove_at_s[item.pad] = time.monotonic() + SHOWN_S

    def tend(self, session: RobotSession) -> bool:
        """Remove a gesture when its time is over, send a status that has changed."""
        for pad, remove_at_s in self._remove_at_s.items():
            if time.monotonic() >= remove_at_s:
                self._remove(session, pad)
                return True
        for pad, status in self._status.items():
            if status != self._sent_status.get(pad):
                self._send_status(session, pad, status)
                return True
        return False

    def ask(self, session: RobotSession) -> None:
        """Check whether a pad's status is as it was written; another touchd's "down" is replaced."""
        pad = next(self._asked)
        name, ours = self._name(pad, "Status"), self._sent_status[pad]
        found = session.call("ALMemory", "getData", name, limit_s=self._limits.call_s)
        if found != ours:
            self._foreign[pad] = found
            self._faults.begin("shared", f"another touchd writes {name}; give one of them robot.prefix")
            if found == "down":
                self._send_status(session, pad, ours)

    def end(self, session: RobotSession) -> None:
        """Remove gestures, and set the status of every pad to down, unless another touchd has it up."""
        for pad in list(self._remove_at_s):
            self._remove(session, pad)
        for pad in self._status:
            if self._foreign.get(pad, "down") == "down":
                self._send_status(session, pad, "down")

    def _name(self, pad: str, event: str) -> str:
        return f"{self._prefix}/{event}" if pad == DEFAULT_PAD else f"{self._prefix}/{pad}/{event}"

    def _send_status(self, session: RobotSession, pad: str, status: str) -> None:
        self._raise_event(session, pad, "Status", status)
        self._sent_status[pad] = status

    def _remove(self, session: RobotSession, pad: str) -> None:
        # Another program may have removed it, and a robot that has restarted has forgotten it.
        with suppress(RobotRefused):
            gesture = self._name(pad, "Gesture")
            session.call("ALMemory", "removeData", gesture, limit_s=self._limits.call_s)
        del self._remove_at_s[pad]

    def _raise_event(self, session: RobotSession, pad: str, event: str, value: object) -> None:
        name = self._name(pad, event)
        session.call("ALMemory", "raiseEvent", name, value, limit_s=self._limits.call_s)


class ActWorker(Worker[Sequence[Act]]):
    """Carries acts out, one after the other, each to its end.

    It has a session of its own: speech takes seconds and must not delay an event.
    """

    def handle(self, session: RobotSession, item: Sequence[Act]) -> None:
        """Carry acts out; refused ones are skipped, and raised as RobotRefused at the end."""
        refused: list[str] = []
        for act in item:
            act.on_begin()
            try:
                session.call(act.service, act.method, *act.arguments, limit_s=self._limits.action_s)
            except RobotRefused as error:
                refused.append(str(error))
            except RobotLost as lost:
                log.warning("an action is given up, with those after it: %s", lost)
                raise
        if refused:
            raise RobotRefused("; ".join(refused))


def client_of(settings: RobotSettings) -> OpenSession:
    """Return what reaches the robot, with its login checked; raises RobotError."""
    if settings.user is not None:
        # It loads ssl, 4.5 MB, which a robot without a login does not need.
        from touchd.drivers.robot.login import read_token

        read_token(settings)
    if settings.client == "touchd":
        return WireSession
    load_qi()
    return QiSession
