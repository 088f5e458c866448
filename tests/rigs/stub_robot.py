"""A robot in this process, without a network."""

from collections.abc import Callable

from touchd.drivers.fakes.services import Call, fake_services
from touchd.drivers.robot.session import RobotLost, RobotRefused, RobotSession


class StubRobot:
    """Answers while it is switched on. say_s: seconds that speech takes. on_call: receives each call."""

    url = "tcp://stub-robot:9559"

    def __init__(self, on_call: Callable[[Call], None] = lambda call: None, say_s: float = 0.0) -> None:
        self._on_call = on_call
        self._say_s = say_s
        self.services: dict[str, object] = {}

    def start(self) -> None:
        """Switch the robot on; it has forgotten everything."""
        self.services = fake_services(self._on_call, say_s=self._say_s)

    def kill(self) -> None:
        """Switch it off; may be called again."""
        self.services = {}

    def __enter__(self) -> "StubRobot":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def open_session(self, *_: object) -> RobotSession:
        return _StubSession(self)


class _StubSession:
    """One connection to a StubRobot, lost when that is switched off."""

    def __init__(self, robot: StubRobot) -> None:
        self._robot = robot
        self._services: dict[str, object] = {}

    def connect(self) -> None:
        self._services = self._robot.services
        if not self._services:
            raise RobotLost("connecting: connection refused")

    def connected(self) -> bool:
        return bool(self._services) and self._services is self._robot.services

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        if not self.connected():
            raise RobotLost(f"{service}.{method}: connection lost")
        try:
            return getattr(self._services[service], method)(*arguments)
        except RuntimeError as error:
            raise RobotRefused(str(error)) from error

    def close(self) -> None:
        self._services = {}
