"""`touchd fake-pad`: a simulated pad behind a pseudo-terminal, to try every command without hardware."""

import argparse
import shlex
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack

from numpy.random import RandomState

from touchd.daemon.app.config import Settings
from touchd.daemon.commands.settings import add_settings, parsed, settings_of
from touchd.daemon.live.address import listen, parse_address, urls_of
from touchd.daemon.playback.rig import encoder_for
from touchd.drivers.fakes.fake_port import LivePort
from touchd.drivers.fakes.hand import PlayedHand, SimulatedPad
from touchd.drivers.installed import program_name

GESTURES, EVERY_S = ("pat", "stroke", "rub", "constant"), 6.0


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd fake-pad",
        description="A simulated pad on a serial port whose path is printed, until Ctrl-C.",
    )
    parser.add_argument(
        "--live", nargs="?", const="", metavar="[HOST:]PORT", help="also serve a page to touch the pad"
    )
    add_settings(parser, "settings, whose pad's format is sent", port=False)
    return parser


def main(arguments: Sequence[str]) -> int:
    """Be a pad until Ctrl-C or SIGTERM; returns 0."""
    options = parsed(parser(), arguments)
    rng = RandomState()
    hand = PlayedHand(GESTURES, EVERY_S, rng)
    found = settings_of(options)
    encode = encoder_for(found.settings.sensor)
    pad = SimulatedPad(rng, hand)
    with ExitStack() as closing:
        if options.live is not None:
            # Imported only with --live, since these modules need its library.
            from touchd.daemon.live.memory import Scene
            from touchd.daemon.live.touch import TouchPage

            live = parse_address(options.live, None)
            listening = closing.enter_context(listen(live))
            page = TouchPage(listening, live, Scene(Settings(), None))
            closing.callback(page.stop)
            page.start()
            pad = SimulatedPad(rng, hand, page.touching, page.show_frame)
            sys.stdout.write(f"live page: {' '.join(urls_of(live, listening.getsockname()[1]))}\n")
        port = closing.enter_context(LivePort(pad.scan, encode))
        file = f" -c {shlex.quote(str(found.file))}" if found.file else ""
        sys.stdout.write(f"pad: {port.path}\nread it with: {program_name()} run{file} --port {port.path}\n")
        sys.stdout.flush()
        threading.Event().wait()
    return 0
