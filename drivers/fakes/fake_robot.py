"""`touchd fake-robot`: a stand-in robot on this computer, to see what a Nao would do.

It speaks the robot's protocol, and prints its address and then every call as lines of JSON.
"""

import argparse
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import IO

import msgspec

from touchd.drivers.errors import os_errors_as, within
from touchd.drivers.fakes.qi_server import QiServer
from touchd.drivers.fakes.services import SERVICES, Call, fake_services
from touchd.drivers.robot.session import RobotError

START_S = 20.0
DESCRIPTION = "A robot's services on 127.0.0.1; prints where it listens, then every call, as JSON."


def add_options(parser: argparse.ArgumentParser) -> None:
    port, seconds = within(int, 0, 2**16 - 1), within(float, 0.0, 9999.0)
    parser.add_argument("--port", type=port, default=9559, help="on 127.0.0.1; 0 for any that is free")
    parser.add_argument("--call-s", type=seconds, default=0.0, help="how long every call takes")
    parser.add_argument("--say-s", type=seconds, default=0.0, help="how long speech takes")
    parser.add_argument(
        "--without", action="append", default=[], choices=SERVICES, help="a service to leave out"
    )
    parser.add_argument("--follow-stdin", action="store_true", help="end when standard input does")


def main(options: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM; returns 0.

    Prints {"listening": url} once all services are ready, then every Call. Raises RobotError.
    """
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    if options.follow_stdin:
        threading.Thread(target=_stop_at_end_of_stdin, args=(stop,), daemon=True).start()

    def report(thing: Call | dict[str, str]) -> None:
        sys.stdout.buffer.write(msgspec.json.encode(thing) + b"\n")
        sys.stdout.buffer.flush()

    services = fake_services(report, call_s=options.call_s, say_s=options.say_s, without=options.without)
    with os_errors_as(RobotError, f"cannot listen on port {options.port}", "choose another with --port"):
        server = QiServer(services, options.port)
    with closing(server):
        report({"listening": server.url})
        stop.wait()
    return 0


def _stop_at_end_of_stdin(stop: threading.Event) -> None:
    # Read the descriptor itself: Python aborts if it ends while a thread waits in sys.stdin.
    while os.read(0, 4096):
        pass
    stop.set()


class LoopbackRobot:
    """Runs a stand-in robot in a process of its own, on a free port, and reads the calls that it reports.

    options: of `touchd fake-robot`. on_call: gets each call, from another thread. program: what Python runs.
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
            raise RobotError("the stand-in robot did not start; its standard error says why")

    def stop(self) -> None:
        """Kill it at once; idempotent."""
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
        """Read the robot's address, then its calls, until it ends."""
        for line in reports:
            report = msgspec.json.decode(line)
            if "listening" in report:
                self.url = report["listening"]
                started.set()
            else:
                self._on_call(msgspec.convert(report, Call))
        started.set()


def program() -> int:
    """Serve as the arguments of this process say."""
    parser = argparse.ArgumentParser(description=DESCRIPTION)
    add_options(parser)
    return main(parser.parse_args())


if __name__ == "__main__":
    sys.exit(program())
