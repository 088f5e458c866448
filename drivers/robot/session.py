"""One connection to NAOqi over qi, on which every call has a limit."""

import importlib
import importlib.util
import os
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Event
from typing import Any, Protocol

from touchd.drivers.errors import TouchdError
from touchd.drivers.extras import how_to_install
from touchd.drivers.robot.limits import RobotLimits

# Poll interval for the stop event while waiting.
SLICE_MS = 50
# Limit for a call once the daemon stops; three of them fit into the two seconds it has for that.
HURRY_S = 0.25


class RobotError(TouchdError):
    """The robot cannot be used as configured: the user must change something. The message is one line."""


class RobotLost(Exception):  # noqa: N818 - says what happened; it is handled, never shown as an error
    """The robot is gone or answers too late (what was asked may still run); only a new session helps."""


class RobotRefused(Exception):  # noqa: N818 - as above
    """The robot answered with an error, or has no such service or method; the session goes on."""


@dataclass(frozen=True)
class Login:
    """The login for a robot that asks for one (NAOqi 2.9). No text made of this shows the token."""

    user: str
    token: str = field(repr=False)


class RobotSession(Protocol):
    """What the link asks of a connection. One thread uses it; after RobotLost it is closed and done with."""

    def connect(self) -> None:
        """Connect and log in; raises RobotLost."""

    def connected(self) -> bool:
        """Return False as soon as the connection is known to be gone; a hung robot still reads True."""

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        """Return what the robot's service answers to builtins; raises RobotLost or RobotRefused."""

    def close(self) -> None:
        """Give the connection up, at once and whatever state it is in."""


# Takes the URL, the login, the limits, and an event that says no call may take longer than HURRY_S any more.
OpenSession = Callable[[str, Login | None, RobotLimits, Event], RobotSession]


def qi_installed() -> bool:
    """Return whether qi, the library that speaks to NAOqi, is there. It is not loaded."""
    return importlib.util.find_spec("qi") is not None


def load_qi() -> Any:
    """Return the module qi, silenced; raises RobotError with one line when it cannot be had."""
    # Read once, when libqi is loaded: a network that drops everything is noticed after 10 s, not 30.
    os.environ.setdefault("QI_TCP_PING_TIMEOUT", "10")
    try:
        qi = importlib.import_module("qi")
    except ImportError as error:
        why = "is not installed" if not qi_installed() else f"cannot be loaded ({error})"
        is_to_be_had = sys.version_info < (3, 13) and platform.machine() == "x86_64"
        instead = how_to_install("nao") if is_to_be_had else "see docs/install.md"
        raise RobotError(
            f"qi, the library that speaks to NAOqi, {why}; "
            f"{instead} (Linux x86_64, Python 3.10 to 3.12), or set robot: null"
        ) from error
    # libqi logs to stdout, which is the daemon's stream of events.
    qi.logging.setLevel(qi.logging.SILENT)
    return qi


class QiSession:
    """A RobotSession over real qi.

    Every operation is asynchronous and waited for with a limit: a synchronous one on a hung robot blocks for
    ever. There are no callbacks and no subscriptions, with which libqi crashes at exit.
    """

    def __init__(self, url: str, login: Login | None, limits: RobotLimits, hurry: Event) -> None:
        self._url = url
        self._limits = limits
        self._hurry = hurry
        self._qi = load_qi()
        self._session = self._qi.Session()
        self._proxies: dict[str, Any] = {}
        if login is not None:
            self._session.setClientAuthenticatorFactory(_Authenticator(login))

    def connect(self) -> None:
        connecting = self._session.connect(self._url, _async=True)
        try:
            self._value(connecting, self._limits.connect_s, "connecting")
        except RobotRefused as refused:
            raise RobotLost(str(refused)) from refused
        except RobotLost as lost:
            # No robot, a wrong token, tcp:// where TLS is wanted, and the reverse: libqi says no more.
            if str(lost).endswith(("disconnected", "stream truncated")):
                advice = "if a robot is there, check user and token, and whether it wants tcp:// or tcps://"
                raise RobotLost(f"{lost}; {advice}") from lost
            raise

    def connected(self) -> bool:
        return bool(self._session.isConnected())

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        if service not in self._proxies:
            found = self._session.service(service, _async=True)
            self._proxies[service] = self._value(found, self._limits.service_s, f"looking for {service}")
        try:
            answer = getattr(self._proxies[service], method)(*arguments, _async=True)
        except AttributeError as error:
            raise RobotRefused(f"{service} has no {method}") from error
        try:
            setting = "robot.action_s" if limit_s == self._limits.action_s else "robot.call_s"
            return self._value(answer, limit_s, f"{service}.{method}", f" (see {setting})")
        except RobotRefused:
            # The service may have ended; once it is back, only a new proxy reaches it.
            del self._proxies[service]
            raise

    def close(self) -> None:
        self._proxies.clear()
        self._session.close(_async=True).wait(round(1000 * HURRY_S))

    def _value(self, future: Any, limit_s: float, what: str, hint: str = "") -> object:
        started_s = time.monotonic()
        while future.wait(SLICE_MS) == self._qi.FutureState.Running:
            waited_s = time.monotonic() - started_s
            if waited_s >= limit_s or (self._hurry.is_set() and waited_s >= HURRY_S):
                raise RobotLost(f"{what}: no answer within {waited_s:.1f} s{hint}")
        try:
            return future.value()
        except RuntimeError as error:
            # qi raises the same for a lost link and for an error of the robot's.
            first_line = (str(error).splitlines() or [type(error).__name__])[0]
            because = f"{what}: {first_line}"
            raise (RobotRefused if self.connected() else RobotLost)(because) from error


class _Authenticator:
    """What libqi asks for the login, and its own factory; libqi calls both methods by these names."""

    def __init__(self, login: Login) -> None:
        self._login = login

    def newAuthenticator(self) -> "_Authenticator":  # noqa: N802
        return self

    def initialAuthData(self) -> dict[str, str]:  # noqa: N802
        return {"user": self._login.user, "token": self._login.token}
