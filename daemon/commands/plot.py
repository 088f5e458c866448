"""`touchd plot`: recordings as a picture; needs matplotlib, of the extra `plot`."""

import argparse
import os
import sys
from pathlib import Path

from rich.console import Console

from touchd.daemon.app.parts import load_model
from touchd.daemon.commands.settings import add_settings, settings_of
from touchd.daemon.playback.stream import add_arguments, chosen_stream
from touchd.drivers.errors import one_line, os_errors_as
from touchd.drivers.recording import SUFFIXES

FORMATS = (".png", ".svg", ".pdf")
DESCRIPTION = "Draws recordings: pressure, touches, answers, mean pads."


def add_options(parser: argparse.ArgumentParser) -> None:
    add_arguments(parser)
    parser.add_argument("-o", "--out", type=Path, metavar="PNG", help="the picture; by default FILE.png")
    add_settings(parser, port=False)


def main(options: argparse.Namespace) -> int:
    """Draw the recordings and print the picture's name; returns 0."""
    # A notebook sets one that is not installed here.
    os.environ["MPLBACKEND"] = "agg"
    # Imported here because they need matplotlib.
    from touchd.daemon.plot import plot

    path: Path = options.out or picture_of(options.files[0])
    if path.suffix not in FORMATS:
        raise plot.PlotError(f"{path}: unknown format; end the name of -o with {', '.join(FORMATS)}")
    settings = settings_of(options).settings
    model = load_model(settings)
    stream = chosen_stream(options)
    # A name from an old disk or archive may not be UTF-8, which matplotlib cannot write.
    names = one_line(", ".join(file.name for file in options.files))
    with Console(stderr=True).status("drawing"):
        traced = plot.trace(stream, settings, model)
        figure = plot.draw_recording(traced, f"{names}, answers of {model.name}")
        with os_errors_as(plot.PlotError, f"{path}: cannot be written", "name another file with -o"):
            figure.savefig(path)
    sys.stdout.write(f"{path}\n")
    return 0


def picture_of(file: Path) -> Path:
    """Return the name of a file's or folder's picture, in the current folder."""
    name = file.absolute().name
    for suffix in SUFFIXES:
        name = name.removesuffix(suffix)
    return Path(f"{name}.png")
