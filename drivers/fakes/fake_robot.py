"""`touchd fake-robot`: a stand-in robot on this computer, to see what a Nao would do.

It speaks the robot's protocol, and prints its address and then every call as lines of JSON.
"""

import argparse
import os
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import closing

import msgspec

from touchd.drivers.errors import os_errors_as, within
from touchd.drivers.fakes.qi_server import QiServer
from touchd.drivers.fakes.services import SERVICES, Call, fake_services
from touchd.drivers.robot.session import RobotError

LONGEST_S = 9999.0


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd fake-robot",
        description="A robot's services on 127.0.0.1; prints where it listens, then every call, as JSON.",
    )
    port, seconds = within(int, 0, 2**16 - 1), within(float, 0.0, LONGEST_S)
    parser.add_argument("--port", type=port, default=9559, help="on 127.0.0.1; 0 for any that is free")
    parser.add_argument("--call-s", type=seconds, default=0.0, help="how long every call takes")
    parser.add_argument("--say-s", type=seconds, default=0.0, help="how long speech takes")
    parser.add_argument(
        "--without", action="append", default=[], choices=SERVICES, help="a service to leave out"
    )
    parser.add_argument("--follow-stdin", action="store_true", help="end when standard input does")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Be a robot until SIGINT or SIGTERM; returns 0.

    Prints {"listening": url} once all services are there, and every Call. Raises RobotError.
    """
    options = parser().parse_args(arguments)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    if options.follow_stdin:
        threading.Thread(target=_stop_at_end_of_stdin, args=(stop,), daemon=True).start()
    writing = threading.Lock()

    def report(thing: Call | dict[str, str]) -> None:
        with writing:
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


if __name__ == "__main__":
    sys.exit(main())
