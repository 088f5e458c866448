"""How a robot is reached: its address and login, time limits, and a session over qi."""

import importlib
import os
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Optional, Protocol, TypeAlias

import msgspec

from touchd.drivers.errors import TouchdError, one_line

if TYPE_CHECKING:
    from touchd.drivers.robot.login import Login

# Poll interval for the stop event while a call runs.
SLICE_MS = 50
# Limit for a call once the daemon stops; three of them fit into the two seconds it has for that.
STOPPING_LIMIT_S = 0.25


class RobotError(TouchdError):
    """The robot cannot be used as configured: the user must change something. The message is one line."""


@dataclass(frozen=True, kw_only=True)
class RobotLimits:
    """Every wait and every buffer of the link to the robot, in seconds unless named otherwise.

    connect_s: for a connection, or for the proxy of a service (measured on loopback: 12 ms and 1 ms).
    call_s: for any call on the event path (0.3 ms; a robot on a bad network needs a hundred times that).
    action_s: for one action; speech and behaviours answer only when they are over, a dance after minutes.
    stale_s: what has waited longer than this is dropped, since a late answer is worse than none.
    heartbeat_s: the robot is asked something after this much silence. With call_s it bounds how long a hang
    goes unnoticed, because a hung robot still looks connected.
    backoff_first_s, backoff_cap_s: pause before another attempt, doubling from the one to the other. The cap
    bounds how long a robot that is back goes unnoticed.
    capacity: messages, or reactions, that wait at most; the oldest is dropped.
    """

    connect_s: float = 3.0
    call_s: float = 1.0
    action_s: float = 600.0
    stale_s: float = 2.0
    heartbeat_s: float = 0.3
    backoff_first_s: float = 0.1
    backoff_cap_s: float = 1.0
    capacity: int = 64


class RobotSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the robot is and how to log in. The token itself is never among the settings.

    trust_network: libqi accepts any certificate, so whoever can step in between gets the token. The token is
    sent beyond this computer only if this says that nobody can.
    """

    url: str
    prefix: str = "TouchGesture"
    user: str | None = None
    token_file: str | None = None
    trust_network: bool = False

    def __post_init__(self) -> None:
        if not re.fullmatch(r"\w+", self.prefix) or self.prefix.startswith("AL"):
            raise ValueError(
                f"prefix {self.prefix!r} must be one word that does not begin with AL (the robot's)"
            )


class RobotLost(Exception):  # noqa: N818 - says what happened; it is handled, never shown as an error
    """The robot is gone or answers too late (a call may still run there); only a new session helps."""


class RobotRefused(Exception):  # noqa: N818 - as above
    """The robot answered with an error, or has no such service or method; the session goes on."""


class RobotSession(Protocol):
    """One connection to a robot. One thread uses it; after RobotLost it is only closed."""

    def connect(self) -> None:
        """Connect and log in; raises RobotLost."""

    def connected(self) -> bool:
        """Return False as soon as the connection is known to be gone; a hung robot still reads True."""

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        """Call a service with builtin types and return its answer; raises RobotLost or RobotRefused."""

    def close(self) -> None:
        """Drop the connection at once; idempotent."""


# Takes URL, login, limits, and an event after which no call may take longer than STOPPING_LIMIT_S.
OpenSession: TypeAlias = Callable[[str, Optional["Login"], RobotLimits, threading.Event], RobotSession]


def load_qi() -> Any:
    """Return the module qi, silenced; raises RobotError with one line when it cannot be loaded."""
    # libqi reads this when it is loaded: a network that drops everything is then noticed after 10 s, not 30.
    os.environ.setdefault("QI_TCP_PING_TIMEOUT", "10")
    # libqi allocates what a header claims: limit it. The longest answers here list a service's methods.
    os.environ.setdefault("QI_MAX_MESSAGE_PAYLOAD", "2000000")
    try:
        qi = importlib.import_module("qi")
    except (ImportError, SyntaxError) as error:
        from touchd.drivers.installed import why_no_qi

        raise RobotError(f"{why_no_qi(error)}, or set robot: null") from error
    # libqi logs to stdout, which is the daemon's stream of events.
    qi.logging.setLevel(qi.logging.SILENT)
    return qi


class QiSession:
    """A RobotSession over real qi.

    Every operation is asynchronous and waited for with a limit: a synchronous one on a hung robot blocks for
    ever. There are no callbacks and no subscriptions, with which libqi crashes at exit.
    """

    def __init__(
        self, url: str, login: "Login | None", limits: RobotLimits, stopping: threading.Event
    ) -> None:
        self._url = url
        self._limits = limits
        self._stopping = stopping
        self._qi = load_qi()
        self._session = self._qi.Session()
        self._proxies: dict[str, Any] = {}
        if login is not None:
            self._session.setClientAuthenticatorFactory(login)

    def connect(self) -> None:
        connecting = self._session.connect(self._url, _async=True)
        try:
            self._value(connecting, self._limits.connect_s, "connecting")
        except RobotRefused as refused:
            raise RobotLost(str(refused)) from refused
        except RobotLost as lost:
            # libqi's error is the same for no robot, a wrong token, and tcp:// mixed up with tcps://.
            if str(lost).endswith(("disconnected", "stream truncated")):
                advice = "if a robot is there, check user and token, and whether it wants tcp:// or tcps://"
                raise RobotLost(f"{lost}; {advice}") from lost
            raise

    def connected(self) -> bool:
        return bool(self._session.isConnected())

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        if service not in self._proxies:
            found = self._session.service(service, _async=True)
            self._proxies[service] = self._value(found, self._limits.connect_s, f"looking for {service}")
        try:
            answer = getattr(self._proxies[service], method)(*arguments, _async=True)
        except AttributeError as error:
            raise RobotRefused(f"{service} has no {method}") from error
        try:
            return self._value(answer, limit_s, f"{service}.{method}")
        except RobotRefused:
            # The service may have ended; once it is back, only a new proxy reaches it.
            del self._proxies[service]
            raise

    def close(self) -> None:
        self._proxies.clear()
        self._session.close(_async=True).wait(round(1000 * STOPPING_LIMIT_S))

    def _value(self, future: Any, limit_s: float, what: str) -> object:
        started_s = time.monotonic()
        while future.wait(SLICE_MS) == self._qi.FutureState.Running:
            waited_s = time.monotonic() - started_s
            if waited_s >= limit_s or (self._stopping.is_set() and waited_s >= STOPPING_LIMIT_S):
                raise RobotLost(f"{what}: no answer within {waited_s:.1f} s")
        try:
            return future.value()
        except RuntimeError as error:
            # qi raises the same error for a lost link and for an error on the robot.
            first_line = (str(error).splitlines() or [type(error).__name__])[0]
            because = one_line(f"{what}: {first_line}")
            raise (RobotRefused if self.connected() else RobotLost)(because) from error
