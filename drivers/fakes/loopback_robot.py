"""A stand-in robot in a separate process, on 127.0.0.1."""

import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from typing import IO

import msgspec

from touchd.drivers.fakes.services import Call
from touchd.drivers.robot.session import RobotError

START_S = 20.0


class LoopbackRobot:
    """Runs a program that is a robot, on a port that is free, and follows its reports.

    options: of `touchd fake-robot`. on_call: receives each call, from a thread of this object. program: what
    Python runs, with the same options.
    """

    def __init__(
        self,
        on_call: Callable[[Call], None],
        options: Sequence[str] = (),
        program: Sequence[str] = ("-m", "touchd.drivers.fakes.fake_robot"),
    ) -> None:
        self._command = [sys.executable, *program, "--follow-stdin", "--port=0", *options]
        self._on_call = on_call
        self.url = ""
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Switch the robot on, also after stop(), which makes it forget everything; raises RobotError."""
        self.url, started = "", threading.Event()
        # It ends with its stdin, a pipe from here: no robot outlives a program that was killed.
        process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        follower = threading.Thread(target=self._follow, args=(process.stdout, started), daemon=True)
        follower.start()
        self._process, self._follower = process, follower
        if not started.wait(START_S) or not self.url:
            self.stop()
            raise RobotError("the stand-in robot did not start; what it said on stderr tells why")

    def stop(self) -> None:
        """Switch it off at once, in the middle of whatever it does; may be called again."""
        if self._process is not None:
            with self._process:
                self._process.kill()
                self._follower.join()
            self._process = None

    def __enter__(self) -> "LoopbackRobot":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _follow(self, reports: IO[bytes], started: threading.Event) -> None:
        """Note the robot's address, then report its calls until it ends."""
        for line in reports:
            report = msgspec.json.decode(line)
            if "listening" in report:
                self.url = report["listening"]
                started.set()
            else:
                self._on_call(msgspec.convert(report, Call))
        started.set()
