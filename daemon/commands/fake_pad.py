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
from touchd.drivers.errors import within
from touchd.drivers.fakes.fake_port import LivePort
from touchd.drivers.fakes.hand import PLAYED, PlayedHand, SimulatedPad
from touchd.drivers.frame import NO_TOUCH
from touchd.drivers.installed import program_name

GESTURES = sorted({*PLAYED, NO_TOUCH})
DEFAULT_GESTURES = "pat,stroke,rub,constant"
LEAST_S, MOST_S = 3.0, 3600.0


def gestures_in(text: str) -> tuple[str, ...]:
    gestures = tuple(text.split(","))
    if unknown := [gesture for gesture in gestures if gesture not in GESTURES]:
        raise argparse.ArgumentTypeError(f"{unknown[0]!r} is none of {', '.join(GESTURES)}")
    return gestures


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd fake-pad",
        description="A simulated pad on a serial port whose path is printed, until Ctrl-C.",
    )
    parser.add_argument(
        "--gestures",
        type=gestures_in,
        default=gestures_in(DEFAULT_GESTURES),
        metavar="pat,stroke",
        help=f"what a simulated hand does, one after another; {DEFAULT_GESTURES} without it",
    )
    every = within(float, LEAST_S, MOST_S)
    parser.add_argument("--every", type=every, default=6.0, metavar="SECONDS", help="from touch to touch")
    parser.add_argument(
        "--live", nargs="?", const="", metavar="[HOST:]PORT", help="also serve a page to touch the pad"
    )
    add_settings(parser, "settings, whose pad's format is sent", port=False)
    return parser


def main(arguments: Sequence[str]) -> int:
    """Be a pad until Ctrl-C or SIGTERM; returns 0."""
    options = parsed(parser(), arguments)
    rng = RandomState()
    hand = PlayedHand(options.gestures, options.every, rng)
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
