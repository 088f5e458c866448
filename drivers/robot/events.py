"""The three events of a pad in the robot's memory: what was felt, its detail, and the pad's status."""

import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from threading import Event

from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.robot.limits import RobotLimits
from touchd.drivers.robot.message import RobotMessage, detail
from touchd.drivers.robot.session import RobotRefused, RobotSession
from touchd.drivers.robot.worker import LinkState, RobotWorker


class EventWorker(RobotWorker[RobotMessage]):
    """Raises PREFIX/Detail and PREFIX/Gesture per answer, and PREFIX/Status when it changes.

    A pad with a name has its own, PREFIX/NAME/Gesture and so on. The Gesture is a plain string that goes from
    the robot's memory after `limits.shown_s`, as that of the robot's own ALTactileGesture does. The Detail is
    raised first, so that whoever wakes on the Gesture finds the one that belongs to it.
    """

    def __init__(
        self,
        prefix: str,
        pads: Iterable[str],
        open_session: Callable[[Event], RobotSession],
        limits: RobotLimits,
        on_state: Callable[[LinkState, str], None],
    ) -> None:
        super().__init__("touchd-robot", open_session, limits, on_state)
        self._prefix = prefix
        self._remove_at_s: dict[str, float] = {}
        self._told_status: dict[str, str] = {}
        # Written by another thread, read here; replacing a value is atomic.
        self._status: dict[str, str] = dict.fromkeys(pads, "up")

    def set_status(self, status: str, pad: str) -> None:
        """Have the robot told a pad's status now; call it from any thread."""
        self._status[pad] = status
        self._wake.set()

    def begin(self, session: RobotSession) -> None:
        for pad, status in self._status.items():
            self._tell_status(session, pad, status)

    def handle(self, session: RobotSession, item: RobotMessage) -> None:
        self._raise(session, self._name(item.pad, "Detail"), detail(item))
        self._raise(session, self._name(item.pad, "Gesture"), str(item.gesture))
        self._remove_at_s[item.pad] = time.monotonic() + self._limits.shown_s

    def tend(self, session: RobotSession) -> bool:
        """Remove a gesture when its time is over, tell a status that has changed."""
        for pad, remove_at_s in self._remove_at_s.items():
            if time.monotonic() >= remove_at_s:
                self._remove(session, pad)
                return True
        for pad, status in self._status.items():
            if status != self._told_status.get(pad):
                self._tell_status(session, pad, status)
                return True
        return False

    def end(self, session: RobotSession) -> None:
        """Leave no gesture behind and say that nothing is felt any more."""
        for pad in list(self._remove_at_s):
            self._remove(session, pad)
        for pad in self._status:
            self._tell_status(session, pad, "down")

    def _name(self, pad: str, event: str) -> str:
        return f"{self._prefix}/{event}" if pad == DEFAULT_PAD else f"{self._prefix}/{pad}/{event}"

    def _tell_status(self, session: RobotSession, pad: str, status: str) -> None:
        self._raise(session, self._name(pad, "Status"), status)
        self._told_status[pad] = status

    def _remove(self, session: RobotSession, pad: str) -> None:
        # Another program may have removed it, and a robot that has restarted has forgotten it.
        with suppress(RobotRefused):
            gesture = self._name(pad, "Gesture")
            session.call("ALMemory", "removeData", gesture, limit_s=self._limits.call_s)
        del self._remove_at_s[pad]

    def _raise(self, session: RobotSession, event: str, value: object) -> None:
        session.call("ALMemory", "raiseEvent", event, value, limit_s=self._limits.call_s)
