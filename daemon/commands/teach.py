"""`touchd teach`: three minutes at the pad adapt the model to its person; needs the extra `train`."""

import argparse
import json
import re
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from daemon.commands.settings import add_settings, settings_of
from daemon.config import ConfigError, Settings, load
from daemon.kept.recording_file import prepare
from daemon.recorder.capture import PadReader
from daemon.recorder.dialogue import HOW, Dialogue, Terms
from daemon.recorder.session import Session, Setting, name
from daemon.terminal.ask import Stopped, ask, ask_name
from daemon.terminal.own_name import own_name
from drivers.errors import os_errors_as
from drivers.numbers import within
from drivers.whole_file import whole_file

ROUNDS = 2
WIDTH = 80
# With a second at either end and the countdown, fourteen recordings take two and a half minutes.
SECONDS = 6.0
COUNTDOWN_S = 2.0


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd teach",
        description="Records every gesture twice, adapts the shipped model to them, says how well it did "
        "before and does after, and puts the new model into use. Interrupted, the same command goes on.",
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder for the recordings and the model")
    add_settings(parser, "settings, in which the new model is set")
    parser.add_argument("--participant", type=name, metavar="NAME", help="who touches; asked if missing")
    parser.add_argument(
        "--rounds", type=within(int, 1, 10), default=ROUNDS, metavar="N", help="of each gesture (%(default)s)"
    )
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each recording (%(default)g)")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Record, adapt, report, and set the model; returns 0."""
    options = parser().parse_args(arguments)
    # Before three minutes of recording, not after: adapting takes torch.
    from model.adapt.head import AdaptSettings
    from model.adapt.report import report_lines
    from model.adapt.ship import adapt_folder, check_output

    console = Console(width=WIDTH, highlight=False, markup=False)
    settings = settings_of(options)
    prepare(options.folder)
    output = _free_name(options.folder)
    check_output(output)
    try:
        _record(console, options, settings)
        console.print("\nLearning from them takes about a minute.")
        adapted = adapt_folder(options.folder, None, output, AdaptSettings())
        for line in report_lines(adapted):
            console.print(line)
        console.print(f"\nThe new model is {output}")
        _put_into_use(console, options.config, output)
    except (Stopped, KeyboardInterrupt):
        console.print("\nStopped. What was kept is safe; the same command goes on from here.")
    return 0


def with_model(text: str, model: Path) -> str:
    """Return a configuration file's text with `model:` set, everything else as it was."""
    line = f"model: {json.dumps(str(model))}"
    changed, count = re.subn(r"^#? ?model:.*$", lambda _: line, text, count=1, flags=re.MULTILINE)
    return changed if count else f"{line}\n{text}"


def _record(console: Console, options: argparse.Namespace, settings: Settings) -> None:
    """Make the recordings that are not there yet; raises Stopped."""
    participant = options.participant or ask_name(console, "Who touches the pad?")
    session = Session(options.folder, Setting(participant), tuple(HOW), options.rounds, 0)
    if all(take.path.exists() for take in session.takes()):
        return
    with PadReader(settings) as pad:
        terms = Terms(options.seconds, COUNTDOWN_S, "not stated", flowing=True)
        Dialogue(console, pad, settings, session, terms).run()


def _free_name(folder: Path) -> Path:
    name = folder.resolve().name
    return next(path for n in range(1, 1000) if not (path := folder / f"{name}-{n}.onnx").exists())


def _put_into_use(console: Console, config: Path | None, model: Path) -> None:
    """Set the model in the configuration, if the person wants it; raises Stopped."""
    if config is None:
        console.print(f"To use it, set `model: {model.resolve()}` in touchd.yaml.")
        return
    if ask(console, f"Enter to use it from now on (in {config}), n to leave things as they are: ", ("", "n")):
        return
    with (
        os_errors_as(ConfigError, f"{config}: cannot be written", "try with sudo"),
        whole_file(config) as new,
    ):
        new.write_text(with_model(config.read_text(encoding="utf-8"), model.resolve()), encoding="utf-8")
        load(new)
    console.print(
        f"Set. A running service takes it over with: sudo systemctl reload touchd\n"
        f"By hand: {own_name()} run -c {config}",
        markup=False,
    )
