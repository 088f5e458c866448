"""`touchd record`: guides a person through a session of recordings, one file each."""

import argparse
from pathlib import Path

from rich.console import Console

from touchd.daemon.app.parts import load_model
from touchd.daemon.commands.settings import add_settings, settings_of
from touchd.daemon.record.capture import PadReader
from touchd.daemon.record.dialogue import GESTURES, HOW, Dialogue
from touchd.daemon.record.session import Session, Setting, ask_name, name
from touchd.daemon.view.terminal import Stopped, text_width
from touchd.drivers.errors import within
from touchd.drivers.recording import prepare_folder
from touchd.model.adapt.folder import trouble_with

INCOMPLETE = 1
DESCRIPTION = (
    "Records the pad for training, one file each, and never overwrites a file. Recordings "
    "that FOLDER has are skipped, so the same command continues after a pause or a crash. touchd asks "
    "for what the options leave open."
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder for the recordings")
    parser.add_argument("--participant", type=name, metavar="NAME", help="who touches the pad")
    parser.add_argument("--substrate", type=name, metavar="NAME", help="what is under the pad, as in foam")
    parser.add_argument("--cover", type=name, metavar="NAME", help="what is over the pad, as in fur")
    parser.add_argument(
        "--gestures",
        type=_names,
        default=",".join(GESTURES),
        metavar="A,B,...",
        help="which, your own too; other: touches that are none of them (%(default)s)",
    )
    parser.add_argument("--rounds", type=within(int, 1, 100), default=1, help="of each gesture (%(default)s)")
    parser.add_argument(
        "--seconds", type=within(float, 1.0, 60.0), default=8.0, help="of each recording (%(default)g)"
    )
    add_settings(parser)


def main(options: argparse.Namespace) -> int:
    """Make the missing recordings, until the person stops.

    Returns 1 while recordings that were asked for are missing.
    """
    console = Console(width=text_width(), highlight=False, markup=False)
    settings = settings_of(options).settings
    try:
        with PadReader(settings, load_model(settings)) as pad:
            prepare_folder(options.folder)
            setting = Setting(
                options.participant or ask_name(console, "Who touches the pad?"),
                options.substrate or ask_name(console, "What is under the pad?", "none"),
                options.cover or ask_name(console, "What is over the pad?", "none"),
            )
            session = Session(options.folder, setting, options.gestures, options.rounds, options.seconds)
            Dialogue(console, pad, session).run()
            return INCOMPLETE if session.missing() else 0
    except (Stopped, KeyboardInterrupt):
        console.print("\nStopped. What was kept is safe; the same command continues from here.")
        return INCOMPLETE


def _names(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(name(part.strip()) for part in text.split(",")))
    if why := trouble_with(names, HOW):
        raise argparse.ArgumentTypeError(why)
    return names
