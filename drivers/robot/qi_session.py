"""A session over qi, the robot's own library, for robots that `wire` does not reach (robot.client: qi)."""

import importlib
import os
import threading
from typing import Any

from touchd.drivers.errors import one_line
from touchd.drivers.installed import how_to_install
from touchd.drivers.robot.session import (
    ADVICE,
    STOPPING_LIMIT_S,
    RobotError,
    RobotLimits,
    RobotLost,
    RobotRefused,
    RobotSettings,
    Wait,
)

# Poll interval for the stop event while a call runs.
SLICE_MS = 50


def load_qi() -> Any:
    """Return the module qi, silenced; raises RobotError with one line when it cannot be loaded."""
    # libqi reads this when it is loaded, so that it does not allocate whatever a message claims.
    os.environ.setdefault("QI_MAX_MESSAGE_PAYLOAD", "2000000")
    try:
        qi = importlib.import_module("qi")
    except (ImportError, SyntaxError) as error:
        raise RobotError(
            f"robot.client: qi cannot be loaded ({error}; PYTHONPATH may lead to another one); leave client "
            f"out, or: {how_to_install('nao')}"
        ) from error
    # libqi logs to stdout, which is the daemon's stream of events.
    qi.logging.setLevel(qi.logging.SILENT)
    return qi


class QiSession:
    """A RobotSession over qi.

    Every operation is asynchronous and waited for with a limit: a synchronous one on a hung robot blocks for
    ever. There are no callbacks and no subscriptions, with which libqi crashes at exit.
    """

    def __init__(self, settings: RobotSettings, limits: RobotLimits, stopping: threading.Event) -> None:
        self._settings, self._limits, self._stopping = settings, limits, stopping
        self._qi = load_qi()
        self._session = self._qi.Session()
        self._proxies: dict[str, Any] = {}

    def connect(self) -> None:
        if self._settings.user is not None:
            login = {"user": self._settings.user, "token": self._settings.read_token()}
            self._session.setClientAuthenticatorFactory(_Authenticator(login))
        url = self._settings.url.strip()
        connecting = self._session.connect(url if "://" in url else f"tcp://{url}", _async=True)
        try:
            self._value(connecting, self._limits.connect_s, "connecting")
        except (RobotRefused, RobotLost) as error:
            # libqi's error is the same for no robot, a wrong token, and tcp:// mixed up with tcps://.
            raise RobotLost(f"{error}; {ADVICE}") from error

    def connected(self) -> bool:
        return bool(self._session.isConnected())

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        if service not in self._proxies:
            found = self._session.service(service, _async=True)
            self._proxies[service] = self._value(found, self._limits.connect_s, f"looking for {service}")
        try:
            answer = getattr(self._proxies[service], method)(*arguments, _async=True)
            return self._value(answer, limit_s, f"{service}.{method}")
        except AttributeError as error:
            raise RobotRefused(f"{service} has no {method}") from error
        except RobotRefused:
            # The service may have ended; once it is back, only a new proxy reaches it.
            del self._proxies[service]
            raise

    def close(self) -> None:
        self._proxies.clear()
        self._session.close(_async=True).wait(round(1000 * STOPPING_LIMIT_S))

    def _value(self, future: Any, limit_s: float, what: str) -> object:
        wait = Wait(what, limit_s, self._stopping)
        while future.wait(SLICE_MS) == self._qi.FutureState.Running:
            wait.go_on()
        try:
            return future.value()
        except RuntimeError as error:
            # qi raises the same error for a lost link and for an error on the robot.
            why = one_line(" ".join(f"{what}: {error}".split()))
            raise (RobotRefused if self.connected() else RobotLost)(why) from error


class _Authenticator:
    """Logs in. libqi calls both methods by these names."""

    def __init__(self, login: dict[str, str]) -> None:
        self._login = login

    def newAuthenticator(self) -> "_Authenticator":  # noqa: N802
        return self

    def initialAuthData(self) -> dict[str, str]:  # noqa: N802
        return self._login
