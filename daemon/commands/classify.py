"""`touchd classify`: the daemon's answers to recordings, without a port, as fast as possible."""

import argparse
import sys

from touchd.daemon.app.parts import load_model
from touchd.daemon.commands.settings import add_settings, settings_of
from touchd.daemon.path.events import Event, encode
from touchd.daemon.path.pipeline import Pipeline
from touchd.daemon.playback.stream import add_arguments, chosen_stream, play
from touchd.daemon.robot.words import words_of
from touchd.daemon.view.describe import describe

DESCRIPTION = "Sends recordings through the daemon's pipeline, with an untouched pad between them."


def add_options(parser: argparse.ArgumentParser) -> None:
    add_arguments(parser)
    add_settings(parser, port=False)
    parser.add_argument("--json", action="store_true", help="events as JSON lines to a terminal too")


def main(options: argparse.Namespace) -> int:
    """Write the events of the chosen recordings, in words to a terminal, else as JSON lines; returns 0."""
    settings = settings_of(options).settings
    in_words = sys.stdout.isatty() and not options.json
    stream, words, model = chosen_stream(options), words_of(settings), load_model(settings)

    def emit(event: Event) -> None:
        line = describe(event, words) if in_words else encode(event).decode()
        sys.stdout.write(f"{line}\n")

    play(stream, lambda clock: Pipeline(settings.pipeline, model, emit, clock))
    return 0
