"""A robot in this process, without qi: for tests and demonstrations where qi cannot be installed."""

import threading
import time
from collections.abc import Callable, Collection

from drivers.fakes.services import SPEECH_NAMES, Call, CallLog, fake_services
from drivers.robot.limits import RobotLimits
from drivers.robot.session import HURRY_S, Login, RobotLost, RobotRefused, RobotSession

LOOK_S = 0.02


class StubRobot:
    """Answers, dies, hangs and comes back as asked, like `LoopbackRobot` but without a network.

    call_s, say_s: what a call, and what speech takes, in seconds. without: services it lacks.
    login: whom it lets in, everybody when left out. on_call: told of each call, from the caller's thread.
    """

    url = "tcp://stub-robot:9559"

    def __init__(
        self,
        *,
        call_s: float = 0.0,
        say_s: float = 0.0,
        without: Collection[str] = (),
        login: Login | None = None,
        on_call: Callable[[Call], None] | None = None,
    ) -> None:
        self.calls = CallLog(on_call)
        self._call_s = call_s
        self._say_s = say_s
        self._without = frozenset(without)
        self._login = login
        self._services: dict[str, object] = {}
        self._changed = threading.Condition()
        self._life = 0
        self._alive = False
        self._hung = False
        if login is not None:
            self.url = "tcps://stub-robot:9503"

    def start(self) -> None:
        """Switch the robot on; also after kill(), and then it has forgotten everything."""
        with self._changed:
            self._life += 1
            self._services = fake_services(self.calls.add, without=self._without)
        self._change(alive=True, hung=False)

    def kill(self) -> None:
        """Switch it off at once, in the middle of whatever it does."""
        self._change(alive=False, hung=self._hung)

    def hang(self) -> None:
        """Stop answering while the connections stay."""
        self._change(alive=self._alive, hung=True)

    def resume(self) -> None:
        """Answer again, first what was asked meanwhile."""
        self._change(alive=self._alive, hung=False)

    def stop(self) -> None:
        """End; may be called again."""
        self.kill()

    def __enter__(self) -> "StubRobot":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def open_session(
        self, url: str, login: Login | None, limits: RobotLimits, hurry: threading.Event
    ) -> RobotSession:
        """Return a new session, as RobotLink asks for it; the URL does not matter here."""
        return _StubSession(self, login, limits, hurry)

    def _change(self, alive: bool, hung: bool) -> None:
        with self._changed:
            self._alive, self._hung = alive, hung
            self._changed.notify_all()

    def _lives(self, life: int) -> bool:
        return self._alive and self._life == life

    def _takes_s(self, service: str) -> float:
        return self._say_s if service in SPEECH_NAMES else self._call_s


class _StubSession:
    """One connection to a StubRobot, which fails as a QiSession does."""

    def __init__(
        self, robot: StubRobot, login: Login | None, limits: RobotLimits, hurry: threading.Event
    ) -> None:
        self._robot = robot
        self._login = login
        self._limits = limits
        self._hurry = hurry
        self._life = 0
        self._what = ""
        self._limit_s = 0.0
        self._asked_s = 0.0

    def connect(self) -> None:
        self._life = self._robot._life
        self._ask("connecting", self._limits.connect_s)
        if self._robot._login is not None and self._login != self._robot._login:
            raise RobotLost("connecting: disconnected; check user and token")

    def connected(self) -> bool:
        return self._robot._lives(self._life)

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        self._ask(f"{service}.{method}", limit_s)
        if service not in self._robot._services:
            raise RobotRefused(f"looking for {service}: no such service")
        try:
            answer: object = getattr(self._robot._services[service], method)(*arguments)
        except AttributeError as error:
            raise RobotRefused(f"{service} has no {method}") from error
        except RuntimeError as error:
            raise RobotRefused(str(error)) from error
        done_s = time.monotonic() + self._robot._takes_s(service)
        self._wait(lambda: time.monotonic() >= done_s and not self._robot._hung)
        return answer

    def close(self) -> None:
        self._life = 0

    def _ask(self, what: str, limit_s: float) -> None:
        """Begin a call: wait while the robot hangs."""
        self._what, self._limit_s, self._asked_s = what, limit_s, time.monotonic()
        self._wait(lambda: not self._robot._hung)

    def _wait(self, answered: Callable[[], bool]) -> None:
        with self._robot._changed:
            while True:
                waited_s = time.monotonic() - self._asked_s
                if not self.connected():
                    raise RobotLost(f"{self._what}: connection lost or refused")
                if answered():
                    return
                if waited_s >= self._limit_s or (self._hurry.is_set() and waited_s >= HURRY_S):
                    raise RobotLost(f"{self._what}: no answer within {waited_s:.1f} s")
                self._robot._changed.wait(LOOK_S)
