"""`touchd fake-robot`: a stand-in robot on this computer, to see what a Nao would do.

It runs real qi services, and prints its address and then every call as lines of JSON.
"""

import argparse
import os
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from typing import NoReturn

import msgspec

from touchd.drivers.fakes.services import SERVICE_NAMES, Call, fake_services
from touchd.drivers.numbers import within
from touchd.drivers.robot.session import RobotError, load_qi

LONGEST_S = 9999.0


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd fake-robot",
        description="Real qi services on 127.0.0.1; prints where it listens, then every call, as JSON lines.",
    )
    port, seconds = within(int, 0, 2**16 - 1), within(float, 0.0, LONGEST_S)
    parser.add_argument("--port", type=port, default=9559, help="on 127.0.0.1; 0 for any that is free")
    parser.add_argument("--call-s", type=seconds, default=0.0, help="how long every call takes")
    parser.add_argument("--say-s", type=seconds, default=0.0, help="how long speech takes")
    parser.add_argument(
        "--without", action="append", default=[], choices=SERVICE_NAMES, help="a service to leave out"
    )
    parser.add_argument("--follow-stdin", action="store_true", help="end when standard input does")
    return parser


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Be a robot until SIGINT or SIGTERM, then end the process with exit code 0.

    Raises RobotError with one line for what the user must change.
    """
    options = parser().parse_args(arguments)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    if options.follow_stdin:
        threading.Thread(target=_stop_at_end_of_stdin, args=(stop,), daemon=True).start()
    _serve(options, stop)
    # Everything is closed and flushed, but libqi's threads may still be releasing our services. If Python
    # ends during that, it aborts (3 times in 80 when a client had just left).
    os._exit(0)


def _serve(options: argparse.Namespace, stop: threading.Event) -> None:
    """Be a robot until told to stop; print {"listening": url} once all services are there, and every Call."""
    qi = load_qi()
    out = sys.stdout.buffer
    writing = threading.Lock()

    def report(thing: Call | dict[str, str]) -> None:
        with writing:
            out.write(msgspec.json.encode(thing) + b"\n")
            out.flush()

    services = fake_services(report, call_s=options.call_s, say_s=options.say_s, without=options.without)
    with ExitStack() as closing:
        session = qi.Session()
        closing.callback(session.close)
        try:
            session.listenStandalone(f"tcp://127.0.0.1:{options.port}")
            url: str = session.endpoints()[0]
        except (RuntimeError, OSError, OverflowError) as error:
            why = getattr(error, "strerror", None) or "another program does, or the system keeps it"
            raise RobotError(
                f"cannot listen on port {options.port}: {why}; choose another with --port"
            ) from error
        for name, service in services.items():
            # In a single thread, speech would block every other call.
            qi.multiThreaded()(type(service))
            session.registerService(name, service)
        report({"listening": url})
        stop.wait()


def _stop_at_end_of_stdin(stop: threading.Event) -> None:
    # Read the descriptor itself: Python aborts if it ends while a thread waits in sys.stdin.
    while os.read(0, 4096):
        pass
    stop.set()


if __name__ == "__main__":
    main()
