"""`touchd record`: guides a person through a session of recordings, one file each."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from touchd.daemon.commands.settings import add_settings, settings_of
from touchd.daemon.record.capture import PadReader
from touchd.daemon.record.dialogue import GESTURES, HOW, Dialogue, Terms
from touchd.daemon.record.session import Session, ask_setting, name
from touchd.daemon.view.terminal import Stopped, text_width
from touchd.drivers.errors import within
from touchd.drivers.recording import prepare
from touchd.model.adapt.folder import trouble_with

INCOMPLETE = 1
MOST_ROUNDS = 100
MOST_GESTURES = 50
SHORTEST_S, LONGEST_S = 1.0, 60.0


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd record",
        description="Records the pad for training, one file each, and never overwrites a file. Recordings "
        "that FOLDER has are skipped, so the same command continues after a pause or a crash. touchd asks "
        "for what the options leave open.",
    )
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
    parser.add_argument(
        "--rounds", type=within(int, 1, MOST_ROUNDS), default=1, help="of each gesture (%(default)s)"
    )
    parser.add_argument(
        "--seconds",
        type=within(float, SHORTEST_S, LONGEST_S),
        default=8.0,
        help="length of each recording (%(default)g)",
    )
    parser.add_argument(
        "--countdown",
        type=within(float, SHORTEST_S, LONGEST_S),
        default=3.0,
        help="seconds of rest before each recording (%(default)g)",
    )
    parser.add_argument("--licence", default="not stated", help="what others may do with the recordings")
    add_settings(parser)
    return parser


def main(arguments: Sequence[str]) -> int:
    """Make the missing recordings, until the person stops.

    Returns 1 while recordings that were asked for are missing.
    """
    options = parser().parse_args(arguments)
    console = Console(width=text_width(), highlight=False, markup=False)
    try:
        return 0 if _record(console, options) else INCOMPLETE
    except (Stopped, KeyboardInterrupt):
        console.print("\nStopped. What was kept is safe; the same command continues from here.")
        return INCOMPLETE


def _record(console: Console, options: argparse.Namespace) -> bool:
    """Record the pad; return whether all recordings are there; raises Stopped."""
    settings = settings_of(options).settings
    with PadReader(settings) as pad:
        prepare(options.folder)
        terms = Terms(options.seconds, options.countdown, options.licence)
        setting = ask_setting(console, options)
        session = Session(options.folder, setting, options.gestures, options.rounds)
        Dialogue(console, pad, settings, session, terms).run()
        return not session.missing()


def _names(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(name(part.strip()) for part in text.split(",")))
    if len(names) > MOST_GESTURES:
        raise argparse.ArgumentTypeError(f"more than {MOST_GESTURES} gestures")
    if why := trouble_with(names, HOW):
        raise argparse.ArgumentTypeError(why)
    return names
