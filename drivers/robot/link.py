"""The link to a Nao: raises answers as events in its memory, and has it act.

The daemon never waits for the robot, whether it is away, hangs or refuses.
"""

import itertools
import logging
import re
import time
import typing
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import partial
from typing import NamedTuple

from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.robot.session import (
    OpenSession,
    RobotLimits,
    RobotRefused,
    RobotSession,
    RobotSettings,
)
from touchd.drivers.robot.worker import LinkState, Worker

if typing.TYPE_CHECKING:
    from touchd.drivers.robot.acting import Act, ActWorker

log = logging.getLogger(__name__)

# How long PREFIX/Gesture stays in the robot's memory, as its own ALTactileGesture does.
SHOWN_S = 1.0


class Told(NamedTuple):
    """An answer to raise. detail: builtin types, integers of four bytes at most."""

    pad: str
    gesture: str
    detail: list[object]


class RobotLink(Worker[Told]):
    """Sends answers to a robot and has it act.

    Raises PREFIX/Detail and PREFIX/Gesture for each answer that is put, and PREFIX/Status when it changes. A
    pad with a name has its own, PREFIX/NAME/Gesture and so on. The Gesture is a plain string that is removed
    from the robot's memory after SHOWN_S, as the robot's own ALTactileGesture is. The Detail is raised first,
    so that a program that wakes on the Gesture finds the Detail that belongs to it.
    Only if it `acts`, a second worker with its own session has the robot speak, move and light up, which
    takes seconds and must not delay an event.
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
        limits: RobotLimits | None = None,
    ) -> None:
        limits = limits or RobotLimits()
        opened = partial(open_session or client_of(settings), settings, limits)
        super().__init__("touchd-robot", opened, limits)
        self._url, self._prefix, self._on_state = settings.url, settings.prefix, on_state
        self._state: LinkState | None = None
        self._remove_at_s: dict[str, float] = {}
        self._sent_status: dict[str, str] = {}
        # Pads whose Status another program writes too.
        self._shared: set[str] = set()
        # Written by another thread, read here; replacing a value is atomic.
        self._status: dict[str, str] = dict.fromkeys(pads, "up")
        self._checked = itertools.cycle(list(self._status))
        self._acts: ActWorker | None = None
        self._workers: list[RobotLink | ActWorker] = [self]
        if acts:
            from touchd.drivers.robot import acting

            self._acts = acting.ActWorker(opened, limits)
            self._workers.append(self._acts)

    def start(self) -> None:
        """Begin to connect; returns at once, and the link keeps trying until it is stopped."""
        super().start()
        if self._acts is not None:
            self._acts.start()

    def act(self, acts: Sequence["Act"]) -> None:
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
        for worker in self._workers:
            worker.ask_to_stop()
        for worker in self._workers:
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
        if state == self._state:
            return
        self._state = state
        try:
            self._on_state(state, reason)
        except Exception:
            log.exception("the state of the robot could not be reported")

    def begin(self, session: RobotSession) -> None:
        for pad, status in self._status.items():
            self._send_status(session, pad, status)

    def handle(self, session: RobotSession, item: Told) -> None:
        self._raise_event(session, self._name(item.pad, "Detail"), item.detail)
        self._raise_event(session, self._name(item.pad, "Gesture"), item.gesture)
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

    def end(self, session: RobotSession) -> None:
        """Remove gestures, and set the status of every pad to down that no other program reports."""
        for pad in list(self._remove_at_s):
            self._remove(session, pad)
        for pad in self._status:
            if pad not in self._shared:
                self._send_status(session, pad, "down")

    def ask(self, session: RobotSession) -> None:
        """Read back a pad's status: with one prefix for two daemons, one's "down" hides the other's pad."""
        pad = next(self._checked)
        sent, key = self._sent_status[pad], self._name(pad, "Status")
        found = session.call("ALMemory", "getData", key, limit_s=self._limits.call_s)
        if found == sent:
            return
        if pad not in self._shared:
            self._shared.add(pad)
            log.warning("another touchd writes %s; give one of them robot.prefix", key)
        if found == "down":
            self._send_status(session, pad, sent)

    def _name(self, pad: str, event: str) -> str:
        return f"{self._prefix}/{event}" if pad == DEFAULT_PAD else f"{self._prefix}/{pad}/{event}"

    def _send_status(self, session: RobotSession, pad: str, status: str) -> None:
        self._raise_event(session, self._name(pad, "Status"), status)
        self._sent_status[pad] = status

    def _remove(self, session: RobotSession, pad: str) -> None:
        # Another program may have removed it, and a robot that has restarted has forgotten it.
        with suppress(RobotRefused):
            gesture = self._name(pad, "Gesture")
            session.call("ALMemory", "removeData", gesture, limit_s=self._limits.call_s)
        del self._remove_at_s[pad]

    def _raise_event(self, session: RobotSession, event: str, value: object) -> None:
        session.call("ALMemory", "raiseEvent", event, value, limit_s=self._limits.call_s)


def client_of(settings: RobotSettings) -> OpenSession:
    """Return what reaches the robot, with its login and certificate checked; raises RobotError."""
    if settings.user is not None or settings.certificate is not None:
        from touchd.drivers.robot.login import check_login

        check_login(settings)
    if settings.client == "qi":
        from touchd.drivers.robot.qi_session import QiSession, load_qi

        load_qi()
        return QiSession
    from touchd.drivers.robot.wire import WireSession

    return WireSession
