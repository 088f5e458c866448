"""`touchd run`: the daemon."""

import argparse
import gc
import logging
import os
import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack

import msgspec

from touchd.daemon.app.config import ConfigError, Settings, config_errors
from touchd.daemon.app.log import LogHandler, LogLines
from touchd.daemon.app.systemd import Health
from touchd.daemon.commands.settings import Found, add_config, find_settings, only_pad
from touchd.daemon.live.address import EVERY_ADDRESS, parse_address, qr_code, urls_of
from touchd.daemon.path.events import Event, RobotEvent, encode
from touchd.daemon.path.service import Service
from touchd.daemon.robot.words import words_of
from touchd.daemon.sinks.sink import LinesSink
from touchd.daemon.sinks.tags import changed, serving_tags
from touchd.daemon.view.describe import describe
from touchd.daemon.view.terminal import listening

# Python's thread switch interval; its default, 5 ms, is longer than an answer takes.
SWITCH_S = 0.0005
LOG_STOP_S = 0.4

log = logging.getLogger(__name__)
DESCRIPTION = (
    "Reads the pad, tells the robot, and writes events to standard output: in words to a "
    "terminal, as JSON lines to anything else."
)


class Signals:
    """Records SIGINT and SIGTERM in a plain attribute: a handler that takes a lock can deadlock with itself.

    SIGHUP also ends a daemon that has a terminal; otherwise it is ignored.
    """

    def __init__(self) -> None:
        self.must_stop = False
        has_terminal = any(map(os.isatty, (0, 1, 2)))
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self.stop)
        # Under nohup it is ignored already.
        if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
            signal.signal(signal.SIGHUP, self.stop if has_terminal else signal.SIG_IGN)

    def stop(self, *_: object) -> None:
        self.must_stop = True

    def ignore(self) -> None:
        """Ignore further signals: the daemon has ended, and the interpreter is about to."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)


def add_options(parser: argparse.ArgumentParser) -> None:
    add_config(parser)
    parser.add_argument("--port", help="read this port instead of the configured one")
    form = parser.add_mutually_exclusive_group()
    form.add_argument(
        "--view", action="store_true", help="show pad, answers and robot in the whole terminal instead"
    )
    form.add_argument("--json", action="store_true", help="JSON lines to a terminal too")
    parser.add_argument(
        "--live",
        nargs="?",
        const="",
        metavar="[HOST:]PORT",
        help="also serve the live page, at 127.0.0.1:8054 unless configured or given here",
    )
    parser.add_argument(
        "--tag",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="put this into every event, as in participant=P07; repeatable; `touchd tag` changes it later",
    )


def main(options: argparse.Namespace) -> int:
    """Run the daemon until Ctrl-C or SIGTERM, or until the reader of its output is gone; returns 0."""
    is_terminal = sys.stdout.isatty()
    if options.view and (not is_terminal or os.environ.get("TERM") in ("dumb", "unknown")):
        raise ConfigError("--view needs a terminal, and a TERM other than dumb or unknown")
    in_words = is_terminal and not options.json
    tags = changed({}, options.tag)
    with config_errors():
        found = _find(options)
    settings = found.settings
    with ExitStack() as closing:
        signals = Signals()
        closing.callback(signals.ignore)
        service = Service(settings)
        ports = [pad.sensor.port for pad in settings.pads.values()]
        closing.enter_context(serving_tags(service.events, tags, found.file, ports))
        live = settings.live
        page = urls_of(live, live.port)[0] if live and live.port else ""
        if options.view:
            handler = _show_in_terminal(service, settings, page, closing)
        else:
            handler = _log_to_stderr(closing)
            form = _in_words(settings) if in_words else encode
            service.add_sink(LinesSink("stdout", sys.stdout.fileno(), form, signals.stop))
            if in_words and page and live and live.host in EVERY_ADDRESS:
                # Phones can reach the page.
                sys.stderr.write(qr_code(page))
        # Never removed: threads may log while the program ends, which must not bypass it to standard error.
        logging.getLogger().addHandler(handler)
        log.info("%s; journal: %s", found, settings.journal.file if settings.journal else "none")
        if settings.robot is None and any(pad.scene.actions for pad in settings.pads.values()):
            log.warning("scene.actions: no robot is configured, so nothing acts; set robot.url")
        favour_latency()
        health = Health(os.environ, service.pads, service.events)
        closing.callback(health.close)
        service.run(lambda: health.update(is_ending=signals.must_stop))
    return 0


def _show_in_terminal(service: Service, settings: Settings, page: str, closing: ExitStack) -> logging.Handler:
    """Show the first pad in the whole terminal; return the log's handler. page: its address."""
    # It imports rich, which a service does not need.
    from touchd.daemon.view.view import View

    first, *_ = settings.pads.values()
    view = View(f"{first.sensor.port} · {page}" if page else first.sensor.port, settings)
    closing.enter_context(view)
    service.add_sink(view)
    service.watchers.append(view)
    view.labeller = service.parts.labeller
    closing.enter_context(listening(view.on_key))
    # Log lines on standard error would corrupt the picture.
    return LogHandler(lambda record: view.note(record.getMessage(), record.levelno >= logging.WARNING))


def _log_to_stderr(closing: ExitStack) -> logging.Handler:
    lines = LogLines(sys.stderr.fileno())
    lines.start()
    closing.callback(lines.stop, LOG_STOP_S)
    return LogHandler(lines.put)


def _find(options: argparse.Namespace) -> Found:
    """Return the settings with the options applied; raises ConfigError."""
    found = find_settings(options.config)
    settings = found.settings
    if options.port:
        if settings.sensors:
            raise ConfigError("--port is for a single pad; set sensors.NAME.port in the file instead")
        settings = only_pad(settings, None, options.port)
    if options.live is not None:
        live = parse_address(options.live, settings.live)
        settings = msgspec.structs.replace(settings, live=live)
    return found._replace(settings=settings)


def _in_words(settings: Settings) -> Callable[[Event], bytes]:
    """Return a function that describes an event in a line, with the pad's name if there are several pads."""
    words = words_of(settings)

    def line(event: Event) -> bytes:
        pad = f"{event.pad}: " if len(settings.pads) > 1 and not isinstance(event, RobotEvent) else ""
        return f"{pad}{describe(event, words)}".encode()

    return line


def favour_latency() -> None:
    """Keep Python's garbage collector from delaying an answer."""
    sys.setswitchinterval(SWITCH_S)
    # Never scan the objects loaded at start-up for garbage: a scan takes as long as an answer.
    gc.collect()
    gc.freeze()
