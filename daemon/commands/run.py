"""`touchd run`: the daemon."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import msgspec

from daemon.config import JournalSettings, RobotConfig, SceneSettings, Settings, load
from daemon.events import RobotEvent, timestamp
from daemon.health import Health
from daemon.journal import Journal
from daemon.notify import Notifier
from daemon.service import Outlet, check_pad, load_model, serve
from daemon.sinks import JournalSink, LinesSink, RobotSink
from drivers.robot import RobotLink, RobotSettings, State

BYTES_PER_MB = 1_000_000


def main(arguments: Sequence[str]) -> int:
    """Run the daemon until Ctrl-C or SIGTERM; returns 0."""
    parser = argparse.ArgumentParser(
        prog="touchd run",
        description="Reads the pad, writes events to standard output as JSON lines, tells the robot.",
    )
    parser.add_argument("-c", "--config", type=Path, metavar="FILE", help="settings; defaults without it")
    parser.add_argument("--port", help="read this port instead of the configured one")
    parser.add_argument(
        "--view", action="store_true", help="show the pad in the terminal instead of JSON lines"
    )
    options = parser.parse_args(arguments)
    settings = load(options.config) if options.config else Settings()
    if options.port:
        settings = msgspec.structs.replace(
            settings, sensor=msgspec.structs.replace(settings.sensor, port=options.port)
        )
    run(settings, with_view=options.view)
    return 0


def run(settings: Settings, with_view: bool) -> None:
    """Run the daemon in this process until a signal, or a reader of its output that is gone, stops it."""
    stop = threading.Event()
    outlet = Outlet()
    show_frame = None
    with ExitStack() as closing:
        closing.enter_context(_stop_on_signals(stop))
        notifier = Notifier(os.environ)
        closing.callback(notifier.close)
        check_pad(settings)
        classifier = load_model(settings)
        closing.callback(outlet.stop)
        if with_view:
            from daemon.view import View, ViewHandler

            view = closing.enter_context(View(f"touchd on {settings.sensor.port}"))
            closing.enter_context(_logging(ViewHandler(view), settings.log_level))
            show_frame = view.show_frame
            outlet.sinks.append(view)
        else:
            closing.enter_context(_logging(logging.StreamHandler(sys.stderr), settings.log_level))
            outlet.sinks.append(LinesSink(sys.stdout.fileno(), on_gone=stop.set))
        if settings.journal is not None:
            outlet.sinks.append(JournalSink(_open_journal(settings.journal)))
        if settings.robot is not None:
            link = RobotLink(_robot_settings(settings.robot, settings.scene), _robot_reporter(outlet))
            outlet.sinks.append(RobotSink(link))
        serve(settings, classifier, outlet, Health(notifier), stop, show_frame)
        notifier.send(STOPPING=1)


@contextmanager
def _stop_on_signals(stop: threading.Event) -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, lambda *_: stop.set())
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _logging(handler: logging.Handler, level: str) -> Iterator[None]:
    root = logging.getLogger()
    handler.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))
    root.addHandler(handler)
    root.setLevel(level.upper())
    try:
        yield
    finally:
        root.removeHandler(handler)


def _open_journal(settings: JournalSettings) -> Journal:
    path = Path(settings.path).expanduser()
    return Journal(path, max_bytes=round(settings.max_mb * BYTES_PER_MB), keep=settings.keep)


def _robot_settings(robot: RobotConfig, scene: SceneSettings) -> RobotSettings:
    return RobotSettings(
        url=robot.url,
        prefix=robot.prefix,
        user=robot.user,
        token_file=robot.token_file,
        token_env=robot.token_env,
        actions=scene.actions,
    )


def _robot_reporter(outlet: Outlet) -> Callable[[State, str], None]:
    def report(state: State, reason: str) -> None:
        outlet.emit(RobotEvent(state=state, time=timestamp(time.time()), reason=reason))

    return report
