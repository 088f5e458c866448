"""`touchd replay`: recordings as a pad on a serial port, for `touchd run` to read."""

import argparse
import shlex
import sys
import threading
from collections.abc import Sequence

import msgspec

from touchd.daemon.commands.settings import add_settings, settings_of
from touchd.daemon.playback.rig import encoder_for
from touchd.daemon.playback.stream import add_arguments, chosen_stream
from touchd.drivers.errors import within
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.installed import program_name
from touchd.drivers.pad.format import PRESETS


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd replay",
        description="Prints the path of a fake serial port, and plays recordings through it as soon as it is "
        "opened (touchd run --port PATH), with notouch before, between and after.",
    )
    add_arguments(parser)
    parser.add_argument("--speed", type=_speed, default=1.0, metavar="1|N|max", help="1 is the pad's own")
    parser.add_argument(
        "--format",
        choices=list(PRESETS),
        help="instead of the configured one",
    )
    add_settings(parser, "configuration file of the pad to play", port=False)
    return parser


def main(arguments: Sequence[str]) -> int:
    """Print the path of a fake port and play the chosen recordings to whoever opens it; returns 0."""
    options = parser().parse_args(arguments)
    found = settings_of(options)
    sensor = found.settings.sensor
    if options.format:
        sensor = msgspec.structs.replace(sensor, format=options.format)
    stream = chosen_stream(options)
    with FakePort(stream, encoder_for(sensor), speed=options.speed) as port:
        sys.stdout.write(f"{port.path}\n")
        sys.stdout.flush()
        if sys.stdout.isatty():
            file = f" -c {shlex.quote(str(found.file))}" if found.file else ""
            sys.stderr.write(f"In another terminal: {program_name()} run{file} --view --port {port.path}\n")
            if options.format:
                sys.stderr.write(f"with `sensor: {{format: {options.format}}}` in its configuration (-c)\n")
        port.wait(threading.TIMEOUT_MAX)
    return 0


def _speed(text: str) -> float | None:
    """Return the pace as FakePort takes it, None for as fast as possible."""
    if text == "max":
        return None
    try:
        return within(float, 0.01, 1000.0)(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"{error}, nor max") from error
