"""`touchd classify`: the daemon's answers to recordings, without a port, as fast as possible."""

import argparse
import sys
import time
from collections.abc import Callable, Sequence

from daemon.commands.settings import add_settings, settings_of
from daemon.events import Event, encode
from daemon.pipeline import Pipeline
from daemon.playback.stream import add_arguments, chosen_stream
from daemon.playback.tally import Tally
from daemon.setup.parts import load_model
from daemon.terminal.describe import describe
from drivers.frame import Frame
from drivers.recording import Stream


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd classify",
        description="Sends recordings through the daemon's pipeline, with notouch before, between and after.",
    )
    add_arguments(parser)
    add_settings(parser, port=False)
    parser.add_argument("--json", action="store_true", help="events as JSON lines to a terminal too")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Write the events of the chosen recordings, in words to a terminal, else as JSON lines; returns 0."""
    options = parser().parse_args(arguments)
    settings = settings_of(options)
    in_words = sys.stdout.isatty() and not options.json
    stream = chosen_stream(options)
    tally = Tally(stream, settings.vocabulary, settings.language)

    def emit(event: Event) -> None:
        tally.put(event)
        line = describe(event, settings.vocabulary, settings.language) if in_words else encode(event).decode()
        sys.stdout.write(f"{line}\n")

    play(stream, Pipeline(settings.pipeline, load_model(settings), emit), tally.at)
    if in_words:
        sys.stdout.write(tally.summary())
    sys.stdout.flush()
    return 0


def play(stream: Stream, pipeline: Pipeline, at: Callable[[int], None] = lambda number: None) -> None:
    """Send a whole stream through a pipeline, as fast as possible. at: takes each frame's number first."""
    for number, (sensor_ms, counts) in enumerate(zip(stream.sensor_ms.tolist(), stream.counts, strict=True)):
        at(number)
        pipeline.on_frame(Frame(number, sensor_ms, time.monotonic(), counts))
    pipeline.flush()
