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
    Raises RobotError if the robot does not start.
    """

    def __init__(
        self,
        on_call: Callable[[Call], None],
        options: Sequence[str] = (),
        program: Sequence[str] = ("-m", "touchd.drivers.fakes.fake_robot"),
    ) -> None:
        self._program = program
        self.url = ""
        self._on_call = on_call
        self._options = ["--port=0", *options]
        self._process: subprocess.Popen[bytes] | None = None
        self._follower: threading.Thread | None = None

    def start(self) -> None:
        """Switch the robot on, also after stop(), which makes it forget everything."""
        command = [sys.executable, *self._program, "--follow-stdin", *self._options]
        # It ends with its stdin, a pipe from here: no robot outlives a program that was killed.
        process = self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert process.stdout is not None
        # Do not wait for ever when the other process fails.
        timer = threading.Timer(START_S, process.kill)
        timer.start()
        try:
            self.url = self._follow(process.stdout)
        finally:
            timer.cancel()
        if not self.url:
            self.stop()
            raise RobotError("the stand-in robot did not start; what it said on stderr tells why")
        self._follower = threading.Thread(
            target=self._follow, args=(process.stdout,), name="touchd-loopback-robot", daemon=True
        )
        self._follower.start()

    def stop(self) -> None:
        """Switch it off at once, in the middle of whatever it does; may be called again."""
        if self._process is None:
            return
        with self._process:
            self._process.kill()
            if self._follower is not None:
                self._follower.join()
        self._process = self._follower = None

    def __enter__(self) -> "LoopbackRobot":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _follow(self, reports: IO[bytes]) -> str:
        """Report the calls until the robot ends, or until it prints its address, which is returned."""
        for line in reports:
            report = msgspec.json.decode(line)
            if "listening" in report:
                return str(report["listening"])
            self._on_call(msgspec.convert(report, Call))
        return ""
