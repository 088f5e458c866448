"""The link to a Nao: raises answers as events in its memory and has it act. The daemon never waits for it."""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.robot.qi_session import QiSession, load_qi
from touchd.drivers.robot.session import OpenSession, RobotLimits, RobotRefused, RobotSession, RobotSettings
from touchd.drivers.robot.wire import WireSession
from touchd.drivers.robot.worker import LinkState, Worker

# How long PREFIX/Gesture stays in the robot's memory, as its own ALTactileGesture does.
SHOWN_S = 1.0
ADVICE = "is it switched on? If it is, check url, user and token, and whether it wants tcp:// or tcps://"
LIMITS = RobotLimits()


class Act(NamedTuple):
    """A call that the robot carries out to its end. on_begin: called from the worker's thread before it."""

    service: str
    method: str
    arguments: tuple[object, ...]
    on_begin: Callable[[], None] = lambda: None


@dataclass
class _Pad:
    """A pad's events. status: the pad's. sent: the last one sent. foreign: the last of another program."""

    prefix: str
    status: str = "up"
    sent: str = ""
    foreign: object = "down"
    remove_at_s: float = math.inf


class RobotLink(Worker):
    """Sends answers to a robot and has it act; raises RobotError with one line if the settings are wrong.

    Raises PREFIX/Detail, then PREFIX/Gesture for each answer, so that a program that wakes on the Gesture
    finds its Detail; and PREFIX/Status when it changes. For a pad with a name PREFIX/NAME/Gesture, …
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
        self._url, self._on_state = settings.url, on_state
        self._state: LinkState | None = None
        prefix = settings.prefix
        self._pads = {pad: _Pad(prefix if pad == DEFAULT_PAD else f"{prefix}/{pad}") for pad in pads}
        # A session of its own: speech takes seconds and must not delay an event.
        self._acts = Worker("touchd-robot-actions", opened, limits)
        self._workers = [self, self._acts] if acts else [self]

    def start(self) -> None:
        """Begin to connect; returns at once, and the link keeps trying until it is stopped."""
        for worker in self._workers:
            Worker.start(worker)

    def put(self, name: str, detail: Sequence[object]) -> None:
        """Raise an answer on a pad, of builtin types. Never waits; call it from one thread."""
        self.do(partial(self._raise_answer, self._pads[name], detail))

    def act(self, acts: Sequence[Act]) -> None:
        """Have the robot carry acts out in order. Never waits; call it from one thread."""
        self._acts.do(partial(_carry_out, acts, self._limits.action_s))

    def set_status(self, status: str, pad: str = DEFAULT_PAD) -> None:
        """Send the robot a pad's state: "up", "degraded" or "down". Never waits; call it from any thread."""
        self._pads[pad].status = status
        self._wake.set()

    def stop(self, timeout_s: float = 2.0) -> None:
        """Disconnect; idempotent."""
        deadline_s = time.monotonic() + timeout_s
        for worker in self._workers:
            worker.ask_to_stop()
        for worker in self._workers:
            worker.join(max(0.0, deadline_s - time.monotonic()))

    def note_state(self, state: LinkState, reason: str) -> None:
        """Log that an attempt to reach the robot failed, or that the robot is back; report a change."""
        if self._stopping.is_set():
            return
        if state == "down":
            what = f"robot {self._url} is down ({reason}); trying until it is there; {ADVICE}"
            self._faults.begin("down", what, cause=reason)
        else:
            self._faults.end("down", f"robot {self._url} is up")
        if state != self._state:
            self._state = state
            self._on_state(state, reason)

    def begin(self, session: RobotSession) -> None:
        for pad in self._pads.values():
            pad.sent = ""
        while self.tend(session):
            pass

    def tend(self, session: RobotSession) -> bool:
        """Remove a gesture whose time is over, or send a status that has changed."""
        for pad in self._pads.values():
            if time.monotonic() >= pad.remove_at_s:
                pad.remove_at_s = math.inf
                # Another program, or a restart of the robot, may have removed it.
                with suppress(RobotRefused):
                    self._memory(session, "removeData", f"{pad.prefix}/Gesture")
                return True
            if (status := pad.status) != pad.sent:
                self._memory(session, "raiseEvent", f"{pad.prefix}/Status", status)
                pad.sent = status
                return True
        return False

    def ask(self, session: RobotSession) -> None:
        """Read the status, as another touchd may have written it; replace its "down"."""
        for pad in self._pads.values():
            found = self._memory(session, "getData", f"{pad.prefix}/Status")
            if found != pad.sent:
                what = f"another touchd writes {pad.prefix}/Status; give one of them robot.prefix"
                self._faults.begin("shared", what)
                pad.foreign, pad.sent = found, "down" if found == "down" else pad.sent

    def end(self, session: RobotSession) -> None:
        """Remove every gesture, and set every status to down unless another touchd has it up."""
        for pad in self._pads.values():
            pad.status, pad.remove_at_s = "down" if pad.foreign == "down" else pad.sent, 0.0
        while self.tend(session):
            pass

    def _raise_answer(self, pad: _Pad, detail: Sequence[object], session: RobotSession) -> None:
        self._memory(session, "raiseEvent", f"{pad.prefix}/Detail", detail)
        self._memory(session, "raiseEvent", f"{pad.prefix}/Gesture", detail[0])
        pad.remove_at_s = time.monotonic() + SHOWN_S

    def _memory(self, session: RobotSession, method: str, *arguments: object) -> object:
        return session.call("ALMemory", method, *arguments, limit_s=self._limits.call_s)


def _carry_out(acts: Sequence[Act], limit_s: float, session: RobotSession) -> None:
    """Carry out acts in order; skip those that are refused, and raise RobotRefused for them at the end."""
    refused: list[str] = []
    for act in acts:
        act.on_begin()
        try:
            session.call(act.service, act.method, *act.arguments, limit_s=limit_s)
        except RobotRefused as error:
            refused.append(str(error))
    if refused:
        raise RobotRefused("; ".join(refused))


def client_of(settings: RobotSettings) -> OpenSession:
    """Return what reaches the robot, with its login checked; raises RobotError."""
    settings.login()
    if settings.client == "touchd":
        return WireSession
    load_qi()
    return QiSession
