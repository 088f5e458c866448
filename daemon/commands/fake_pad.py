"""`touchd fake-pad`: a simulated pad behind a pseudo-terminal, to try every command without hardware."""

from __future__ import annotations

import argparse
import shlex
import sys
import threading
import typing
from contextlib import ExitStack

from numpy.random import RandomState

from touchd.daemon.app.config import Settings
from touchd.daemon.commands.settings import add_settings, settings_of
from touchd.daemon.live.address import parse_address
from touchd.daemon.playback.rig import encoder_for
from touchd.drivers.fakes.fake_port import LivePort
from touchd.drivers.fakes.hand import SimulatedPad
from touchd.drivers.installed import program_name

if typing.TYPE_CHECKING:
    from touchd.daemon.live.touch import TouchPage
    from touchd.model.classifier import Classifier

GESTURES, EVERY_S = ("pat", "stroke", "rub", "constant"), 6.0
# Time limit for the page.
STOP_S = 1.0
DESCRIPTION = "A simulated pad on a serial port whose path is printed, until Ctrl-C."


def add_live(parser: argparse.ArgumentParser) -> None:
    """Add the option --live of a simulated pad."""
    parser.add_argument(
        "--live", nargs="?", const="", metavar="[HOST:]PORT", help="also serve a page to touch the pad"
    )


def serve_page(closing: ExitStack, settings: Settings, model: Classifier | None) -> TouchPage:
    """Serve a page to touch a simulated pad."""
    # Imported only with --live, since it needs its library.
    from touchd.daemon.live.touch import TouchPage

    page = TouchPage(settings, model)
    closing.callback(page.stop, STOP_S)
    page.start()
    return page


def add_options(parser: argparse.ArgumentParser) -> None:
    add_live(parser)
    add_settings(parser, "settings, whose pad's format is sent", port=False)


def main(options: argparse.Namespace) -> int:
    """Serve a simulated pad until Ctrl-C or SIGTERM; returns 0."""
    found = settings_of(options)
    pad = SimulatedPad(RandomState(), GESTURES, EVERY_S)
    with ExitStack() as closing:
        if options.live is not None:
            page = serve_page(closing, Settings(live=parse_address(options.live, None)), None)
            pad = SimulatedPad(RandomState(), GESTURES, EVERY_S, page.touching, on_frame=page.put_frame)
            sys.stdout.write(f"live page: {' '.join(page.urls)}\n")
        port = closing.enter_context(LivePort(pad.scan, encoder_for(found.settings.sensor)))
        file = f" -c {shlex.quote(str(found.file))}" if found.file else ""
        where = f", once sensors.{options.pad}.port is set to it" if options.pad else f" --port {port.path}"
        sys.stdout.write(f"pad: {port.path}\nread it with: {program_name()} run{file}{where}\n")
        sys.stdout.flush()
        threading.Event().wait()
    return 0
