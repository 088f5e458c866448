"""`touchd plot`: recordings, or a journal of events, as a picture; needs matplotlib, of the extra `plot`."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from touchd.daemon.commands.settings import add_settings, load_model, settings_of
from touchd.daemon.playback.stream import add_arguments, chosen_stream
from touchd.daemon.sinks.touches import read_journal
from touchd.drivers.errors import one_line
from touchd.drivers.recording import SUFFIXES

MOST_TOUCHES = 24


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd plot",
        description="Draws recordings (pressure, touches, answers, mean pads) or a journal's last touches.",
    )
    add_arguments(parser)
    parser.add_argument("-o", "--out", type=Path, metavar="PNG", help="the picture; by default FILE.png")
    add_settings(parser, port=False)
    return parser


def main(arguments: Sequence[str]) -> int:
    """Draw the files and print the picture's name; returns 0."""
    options = parser().parse_args(arguments)
    # A notebook sets one that is not installed here.
    os.environ["MPLBACKEND"] = "agg"
    # Imported here because they need matplotlib.
    from touchd.daemon.plot import plot

    path: Path = options.out or picture_of(options.files[0])
    plot.check_format(path)
    # A name from an old disk or archive may not be UTF-8, which matplotlib cannot write.
    names = one_line(", ".join(file.name for file in options.files))
    if all(file.is_dir() or file.name.endswith(SUFFIXES) for file in options.files):
        settings = settings_of(options).settings
        model = load_model(settings)
        stream = chosen_stream(options)
        with Console(stderr=True).status("drawing"):
            traced = plot.trace(stream, settings, model)
            figure = plot.draw_recording(traced, f"{names}, answers of {model.name}")
    elif len(options.files) == 1:
        figure = plot.draw_touches(read_journal(options.files[0])[-MOST_TOUCHES:], names)
    else:
        raise plot.PlotError(f"{names}: give one journal, or recordings only")
    plot.save(figure, path)
    sys.stdout.write(f"{path}\n")
    return 0


def picture_of(file: Path) -> Path:
    """Return the name of a file's or folder's picture, in the current folder."""
    name = file.absolute().name
    for suffix in (*SUFFIXES, ".jsonl"):
        name = name.removesuffix(suffix)
    return Path(f"{name}.png")
