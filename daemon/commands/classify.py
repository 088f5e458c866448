"""`touchd classify`: what the daemon would have said to recordings, without a port, as fast as it goes."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from daemon.config import Settings, load
from daemon.events import Event, encode
from daemon.parts import load_model
from daemon.pipeline import Pipeline
from daemon.playback.stream import add_arguments, chosen_stream
from drivers.frame import Frame
from drivers.recording import Stream


def parser() -> argparse.ArgumentParser:
    """Return what the command line takes."""
    parser = argparse.ArgumentParser(
        prog="touchd classify",
        description="Sends recordings through the daemon's pipeline, with notouch before, between and after.",
    )
    add_arguments(parser)
    parser.add_argument("-c", "--config", type=Path, metavar="FILE", help="settings; defaults without it")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Write the events of the chosen recordings to standard output as JSON lines; returns 0."""
    options = parser().parse_args(arguments)
    settings = load(options.config) if options.config else Settings()
    pipeline = Pipeline(settings.pipeline, load_model(settings), _write)
    play(chosen_stream(options), pipeline)
    sys.stdout.flush()
    return 0


def play(stream: Stream, pipeline: Pipeline) -> None:
    """Send a whole stream through a pipeline, as fast as that takes it."""
    for number, (sensor_ms, counts) in enumerate(zip(stream.sensor_ms.tolist(), stream.counts, strict=True)):
        pipeline.on_frame(Frame(number, sensor_ms, time.monotonic(), counts))
    pipeline.flush()


def _write(event: Event) -> None:
    sys.stdout.buffer.write(encode(event) + b"\n")
