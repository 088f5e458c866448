"""A stand-in robot that records its calls, and a link that records its states."""

import importlib.util
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest
import trustme
from rigs.call_log import CallLog
from rigs.login_gate import Gate, Login
from rigs.made_events import PREDICTION
from rigs.sockets import free_port
from rigs.stub_robot import StubRobot
from rigs.wait import wait_for

from touchd.daemon.path.events import timestamp
from touchd.daemon.robot.sink import detail_of
from touchd.drivers.fakes.fake_robot import LoopbackRobot
from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.robot.link import LIMITS, Act, RobotLink
from touchd.drivers.robot.session import RobotLimits, RobotSettings

HAS_QI = importlib.util.find_spec("qi") is not None
needs_qi = pytest.mark.skipif(not HAS_QI, reason="qi is not installed")
# With what touchd reaches the robot: its own session, and qi's.
CLIENTS = ["touchd", pytest.param("qi", marks=needs_qi)]


class Robot(LoopbackRobot):
    """A robot that records its calls, dies, hangs and comes back on the same port.

    It stands on the robot's own library if that is installed, else, or with is_ours, on our server.
    call_s, say_s: duration of a call and of speech, in seconds. without: services it lacks. login: if set,
    the robot uses TLS and asks for it, as NAOqi 2.9 does.
    """

    def __init__(
        self,
        *,
        call_s: float = 0.0,
        say_s: float = 0.0,
        without: Sequence[str] = (),
        login: Login | None = None,
        is_ours: bool = not HAS_QI,
    ) -> None:
        self.calls = CallLog()
        self._login = login
        self.gate: Gate | None = None
        self._gate_port = free_port()
        self.authority = trustme.CA()
        options = [f"--port={free_port()}", f"--call-s={call_s}", f"--say-s={say_s}"]
        options += [f"--without={name}" for name in without]
        theirs = [str(Path(__file__).with_name("qi_robot.py"))]
        super().__init__(self.calls.add, options, *([] if is_ours else [theirs]))

    def start(self) -> None:
        """Switch it on, also after stop()."""
        super().start()
        if self._login is not None:
            self.gate = Gate(self._gate_port, int(self.url.rpartition(":")[2]), self._login, self.authority)
            self.url = f"tcps://127.0.0.1:{self._gate_port}"

    def stop(self) -> None:
        super().stop()
        if self.gate is not None:
            self.gate.close()

    def hang(self, signal_: signal.Signals = signal.SIGSTOP) -> None:
        """Stop answering; the connections stay open."""
        assert self._process is not None
        self._process.send_signal(signal_)

    def resume(self) -> None:
        """Answer again, queued calls first."""
        self.hang(signal.SIGCONT)


LOGIN = Login("nao", "s3cret-token")
# Notices a hang quickly; by default it takes 1.3 s.
IMPATIENT = RobotLimits(call_s=0.3, heartbeat_s=0.1)
GESTURE, DETAIL, STATUS = "TouchGesture/Gesture", "TouchGesture/Detail", "TouchGesture/Status"


def message(
    gesture: str = "stroke",
    touch: int = 1,
    time_s: float | None = None,
    sequence: int | None = None,
    **other: Any,
) -> tuple[str, list[object]]:
    """Return a pad and the detail of an answer."""
    values = {"gesture": gesture, "touch": touch, "time": timestamp(time_s or time.time()), **other}
    answer = msgspec.structs.replace(PREDICTION, **values)
    return answer.pad, detail_of(answer, sequence or touch)


def say(words: str) -> Act:
    return Act("ALTextToSpeech", "say", (words,))


def answer(link: RobotLink, gesture: str = "stroke", touch: int = 1) -> None:
    """Publish an answer, and have the robot say it."""
    link.put(*message(gesture, touch))
    link.act([say(gesture)])


def hears(robot: Robot, link: RobotLink, gesture: str = "pat") -> None:
    """Assert that a robot receives a gesture that is published now."""
    link.put(*message(gesture))
    robot.calls.wait_for_raise(GESTURE, gesture)


def login_in(folder: Path, login: Login = LOGIN) -> dict[str, Any]:
    """Return the settings for a login at whatever robot answers, with the token in a file of a folder."""
    token = folder / "token"
    # As an editor on Windows may save it.
    token.write_bytes(f"\ufeff{login.token}\r\n".encode())
    return {"user": login.user, "token_file": str(token), "certificate": "any"}


class States:
    """The states that a link has reported."""

    def __init__(self) -> None:
        self.told: list[tuple[str, str]] = []

    def __call__(self, state: str, reason: str) -> None:
        self.told.append((state, reason))

    def wait_for(self, *states: str) -> str:
        """Wait until exactly these states were reported; returns the reason of the last."""
        wait_for(lambda: [*states] == [state for state, _ in self.told])
        return self.told[-1][1]


@contextmanager
def linked(
    robot: Robot | StubRobot,
    *,
    limits: RobotLimits = LIMITS,
    acts: bool = False,
    pads: Sequence[str] = (DEFAULT_PAD,),
    **settings: Any,
) -> Iterator[tuple[RobotLink, States]]:
    """A started link to a robot, and the states it reports; stopped at the end."""
    states = States()
    opened = robot.open_session if isinstance(robot, StubRobot) else None
    reached = RobotSettings(**{"url": robot.url, **settings})
    link = RobotLink(reached, states, opened, pads=pads, acts=acts, limits=limits)
    link.start()
    try:
        yield link, states
    finally:
        link.stop()


def link_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("touchd-robot")]
