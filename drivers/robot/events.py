"""The three events in the robot's memory: what was felt, its detail, and whether anything can be felt."""

from __future__ import annotations

import time
from contextlib import suppress

from drivers.robot.limits import RobotLimits
from drivers.robot.message import RobotMessage, detail
from drivers.robot.session import RobotRefused, RobotSession
from drivers.robot.worker import State


class EventDuty:
    """Raises PREFIX/Detail and PREFIX/Gesture per answer, and PREFIX/Status when it changes.

    The Gesture is a plain string that goes from the robot's memory after `limits.shown_s`, as that of the
    robot's own ALTactileGesture does. The Detail is raised first, so that whoever wakes on the Gesture finds
    the one that belongs to it.
    """

    def __init__(self, prefix: str, limits: RobotLimits) -> None:
        self._gesture, self._detail, self._status = (
            f"{prefix}/{name}" for name in ("Gesture", "Detail", "Status")
        )
        self._limits = limits
        self._remove_at_s: float | None = None
        self._told_status: State | None = None
        # Written by whoever knows the pad, read here; assigning a name is atomic.
        self.status: State = "up"

    def begin(self, session: RobotSession) -> None:
        """Tell the robot the status."""
        self._tell_status(session, self.status)

    def handle(self, session: RobotSession, item: RobotMessage) -> None:
        """Tell the robot one answer."""
        self._raise(session, self._detail, detail(item))
        self._raise(session, self._gesture, str(item.gesture))
        self._remove_at_s = time.monotonic() + self._limits.shown_s

    def tend(self, session: RobotSession) -> bool:
        """Remove the gesture when its time is over, tell a status that has changed."""
        if self._remove_at_s is not None and time.monotonic() >= self._remove_at_s:
            self._remove(session)
            return True
        if self.status != self._told_status:
            self._tell_status(session, self.status)
            return True
        return False

    def end(self, session: RobotSession) -> None:
        """Leave no gesture behind and say that nothing is felt any more."""
        if self._remove_at_s is not None:
            self._remove(session)
        self._tell_status(session, "down")

    def _tell_status(self, session: RobotSession, status: State) -> None:
        self._raise(session, self._status, status)
        self._told_status = status

    def _remove(self, session: RobotSession) -> None:
        # Another program may have removed it, and a robot that has restarted has forgotten it.
        with suppress(RobotRefused):
            session.call("ALMemory", "removeData", self._gesture, limit_s=self._limits.call_s)
        self._remove_at_s = None

    def _raise(self, session: RobotSession, event: str, value: object) -> None:
        session.call("ALMemory", "raiseEvent", event, value, limit_s=self._limits.call_s)
