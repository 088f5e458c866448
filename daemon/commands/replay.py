"""`touchd replay`: recordings as a pad on a serial port, for `touchd run` to read."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

import msgspec

from daemon.config import SensorSettings, load
from daemon.destinations import encoder_for
from daemon.playback.stream import add_arguments, chosen_stream
from drivers.fakes.fake_port import FakePort


def main(arguments: Sequence[str]) -> int:
    """Print the path of a fake port and play the chosen recordings to whoever opens it; returns 0."""
    parser = argparse.ArgumentParser(
        prog="touchd replay",
        description="Plays recordings through a fake serial port, with notouch before, between and after, "
        "as soon as it is opened: touchd run --port PATH",
    )
    add_arguments(parser)
    parser.add_argument("--speed", type=_speed, default=1.0, metavar="1|N|max", help="pace; 1 is a pad's own")
    parser.add_argument("--protocol", choices=("fabric-grid", "csv"), help="instead of the configured one")
    parser.add_argument("-c", "--config", type=Path, metavar="FILE", help="settings of the pad to be")
    options = parser.parse_args(arguments)
    sensor = load(options.config).sensor if options.config else SensorSettings()
    if options.protocol:
        sensor = msgspec.structs.replace(sensor, protocol=options.protocol)
    stream = chosen_stream(options)
    # Both end the wait below by KeyboardInterrupt, which is a clean end.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with FakePort(stream, encoder_for(sensor), speed=options.speed) as port:
        sys.stdout.write(f"{port.path}\n")
        sys.stdout.flush()
        port.wait(threading.TIMEOUT_MAX)
    return 0


def _speed(text: str) -> float | None:
    """Return the pace as FakePort takes it, None for flat out."""
    if text == "max":
        return None
    speed = float(text)
    if not 0 < speed < 1e6:
        raise argparse.ArgumentTypeError(f"{text} is neither a pace above 0 nor max")
    return speed
