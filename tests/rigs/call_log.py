"""The calls that a stand-in robot received."""

import threading
from collections.abc import Callable

from rigs.wait import SOON_S

from touchd.drivers.fakes.services import Call


class CallLog:
    """The calls so far. Safe to use from several threads."""

    def __init__(self) -> None:
        self._calls: list[Call] = []
        self._grew = threading.Condition()

    def add(self, call: Call) -> None:
        """Record a call."""
        with self._grew:
            self._calls.append(call)
            self._grew.notify_all()

    def all(self) -> list[Call]:
        """Return the calls so far, oldest first."""
        with self._grew:
            return list(self._calls)

    def clear(self) -> None:
        """Clear the calls so far."""
        with self._grew:
            self._calls.clear()

    def raised(self, event: str) -> list[object]:
        """Return the values with which an event was raised in the robot's memory, oldest first."""
        return [call.arguments[1] for call in self.all() if _is_raise(call, event)]

    def said(self) -> list[object]:
        """Return what the robot said, plainly or animated, oldest first."""
        return [call.arguments[0] for call in self.all() if call.method == "say"]

    def wait_for(self, wanted: Callable[[Call], bool], timeout_s: float = SOON_S) -> Call:
        """Return the first matching call, waiting for it; raises TimeoutError with the last calls."""
        with self._grew:
            if not self._grew.wait_for(lambda: any(map(wanted, self._calls)), timeout_s):
                raise TimeoutError(f"not within {timeout_s:g} s; the last calls were {self._calls[-5:]}")
            return next(filter(wanted, self._calls))

    def wait_for_raise(self, event: str, value: object, timeout_s: float = SOON_S) -> Call:
        """Return the call that raised an event with this value; raises TimeoutError."""
        return self.wait_for(
            lambda call: _is_raise(call, event) and call.arguments[1] == value, timeout_s=timeout_s
        )


def _is_raise(call: Call, event: str) -> bool:
    return call.method == "raiseEvent" and call.arguments[0] == event and not call.refused
