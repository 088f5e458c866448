"""A robot made of real qi services in a process of its own, on 127.0.0.1."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Collection
from typing import IO

import msgspec

from drivers.fakes.services import Call
from drivers.robot.session import Login, RobotError, load_qi

START_S = 20.0
TOKEN_ENV = "TOUCHD_FAKE_ROBOT_TOKEN"


class LoopbackRobot:
    """Runs `python -m drivers.fakes.fake_robot`, follows its reports, and lets it die and come back.

    port: 0 for any that is free; it is kept over kill() and start(). call_s, say_s: what a call, and speech,
    takes, in seconds. without: services it lacks. login: with one, the robot speaks TLS and asks for it, as
    NAOqi 2.9 does. on_call: told of each call, from a thread of this object.
    Raises RobotError where qi is not installed or the robot does not start.
    """

    def __init__(
        self,
        *,
        port: int = 0,
        call_s: float = 0.0,
        say_s: float = 0.0,
        without: Collection[str] = (),
        login: Login | None = None,
        on_call: Callable[[Call], None] = lambda call: None,
    ) -> None:
        load_qi()
        self._on_call = on_call
        self.url = ""
        self._port = port
        self._login = login
        self._options = [f"--call-s={call_s}", f"--say-s={say_s}", *(f"--without={name}" for name in without)]
        self._process: subprocess.Popen[bytes] | None = None
        self._follower: threading.Thread | None = None

    def start(self) -> None:
        """Switch the robot on; also after kill(), on the same port, and then it has forgotten everything."""
        command = [sys.executable, "-m", "drivers.fakes.fake_robot", f"--port={self._port}", "--follow-stdin"]
        environment = dict(os.environ)
        if self._login is not None:
            command += [f"--user={self._login.user}", f"--token-env={TOKEN_ENV}"]
            environment[TOKEN_ENV] = self._login.token
        # It ends with its stdin, a pipe from here: no robot outlives a test that was killed.
        self._process = subprocess.Popen(
            [*command, *self._options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
        )
        assert self._process.stdout is not None
        self.url = self._wait_for_url(self._process.stdout)
        self._port = int(self.url.rsplit(":", 1)[1])
        self._follower = threading.Thread(
            target=self._follow, args=(self._process.stdout,), name="touchd-loopback-robot", daemon=True
        )
        self._follower.start()

    def kill(self) -> None:
        """Switch it off at once, in the middle of whatever it does."""
        self._signal(signal.SIGKILL)
        self._end()

    def stop(self) -> None:
        """End, in whatever state it is; may be called again."""
        if self._process is not None:
            self.kill()

    def __enter__(self) -> "LoopbackRobot":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _wait_for_url(self, reports: IO[bytes]) -> str:
        # Do not wait for ever when the other process fails.
        timer = threading.Timer(START_S, self._signal, args=(signal.SIGKILL,))
        timer.start()
        url = self._follow(reports)
        timer.cancel()
        if not url:
            self._end()
            raise RobotError("the stand-in robot did not start; what it said on stderr tells why")
        return url

    def _follow(self, reports: IO[bytes]) -> str:
        """Report the calls until the robot says where it listens, which is returned, or until its end."""
        for line in reports:
            report = msgspec.json.decode(line)
            if "listening" in report:
                return str(report["listening"])
            self._on_call(msgspec.convert(report, Call))
        return ""

    def _signal(self, number: signal.Signals) -> None:
        if self._process is not None:
            self._process.send_signal(number)

    def _end(self) -> None:
        if self._process is None:
            return
        self._process.wait()
        if self._follower is not None:
            self._follower.join()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._process = self._follower = None
