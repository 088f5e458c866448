"""A session over qi, the robot's own library, for robots that `wire` does not reach (robot.client: qi)."""

import importlib
import os
import threading
from typing import Any

from touchd.drivers.installed import how_to_install
from touchd.drivers.robot.session import RobotError, RobotLimits, RobotRefused, RobotSettings, waiting

# Poll interval for the stop event while a call runs; how long closing may take.
SLICE_MS, CLOSE_MS = 50, 250


def load_qi() -> Any:
    """Return the module qi, silenced; raises RobotError with one line when it cannot be loaded."""
    # libqi reads this limit when it is loaded; without it, it allocates whatever size a message claims.
    os.environ.setdefault("QI_MAX_MESSAGE_PAYLOAD", "2000000")
    try:
        qi = importlib.import_module("qi")
    except (ImportError, SyntaxError) as error:
        why = f"robot.client: qi cannot be loaded ({error}; PYTHONPATH may lead to another one)"
        raise RobotError(f"{why}; leave client out, or: {how_to_install('nao')}") from error
    # libqi logs to stdout, which is the daemon's stream of events.
    qi.logging.setLevel(qi.logging.SILENT)
    return qi


class QiSession:
    """A RobotSession over qi.

    Every operation is asynchronous, and the wait for it is limited: a synchronous call of a hung robot blocks
    for ever. It uses no callbacks and no subscriptions, with which libqi crashes at exit.
    """

    def __init__(self, settings: RobotSettings, limits: RobotLimits, stopping: threading.Event) -> None:
        self._settings, self._limits, self._stopping = settings, limits, stopping
        self._qi = load_qi()
        self._session = self._qi.Session()
        self._proxies: dict[str, Any] = {}

    def connect(self) -> None:
        if login := self._settings.login():
            # libqi calls both methods by these names, and accepts only an instance of a class.
            methods = {"newAuthenticator": lambda each: each, "initialAuthData": lambda _: login}
            self._session.setClientAuthenticatorFactory(type("Authenticator", (), methods)())
        url = "{}://{}:{}".format(*self._settings.address)
        self._value(self._session.connect(url, _async=True), self._limits.connect_s, "connecting")

    def connected(self) -> bool:
        return bool(self._session.isConnected())

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        if service not in self._proxies:
            found = self._session.service(service, _async=True)
            self._proxies[service] = self._value(found, self._limits.connect_s, f"looking for {service}")
        try:
            answer = self._proxies[service].call(method, *arguments, _async=True)
            return self._value(answer, limit_s, f"{service}.{method}")
        except RobotRefused:
            # The service may have restarted; only a new proxy reaches it then.
            del self._proxies[service]
            raise

    def close(self) -> None:
        self._session.close(_async=True).wait(CLOSE_MS)

    def _value(self, future: Any, limit_s: float, what: str) -> Any:
        with waiting(what, limit_s, self._stopping) as go_on:
            while future.wait(SLICE_MS) == self._qi.FutureState.Running:
                go_on()
            try:
                return future.value()
            except RuntimeError as error:
                # qi raises the same error for a lost link and for an error on the robot.
                raise (RobotRefused if self.connected() else OSError)(str(error)) from error
