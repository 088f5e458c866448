"""`touchd teach`: adapts the model to a person in five minutes; needs the extra `train`."""

import argparse
import json
import shlex
from pathlib import Path

from rich.console import Console

from touchd.daemon.app.config import Settings
from touchd.daemon.app.parts import load_model
from touchd.daemon.commands.record import INCOMPLETE
from touchd.daemon.commands.settings import SERVICE_FOLDER, add_settings, settings_of
from touchd.daemon.record.capture import PadReader
from touchd.daemon.record.dialogue import EDGE_S, GESTURES, HOW, HOW_ONCE, Dialogue
from touchd.daemon.record.session import Session, Setting, ask_name, name
from touchd.daemon.robot.words import name_of, words_of
from touchd.daemon.view.terminal import Stopped, text_width
from touchd.drivers.errors import within
from touchd.drivers.recording import prepare_folder

ROUNDS = 2
# With a trimmed second at each end and the countdown, fourteen recordings take 2.5 minutes; four touches made
# once take half a minute.
SECONDS = 6.0
DESCRIPTION = (
    "Records every gesture, a single pat and a single stroke, each twice, adapts the shipped model to "
    "the recordings, and prints how often it was right before and after, and how to use the new model. "
    "Repeat the command if interrupted."
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder for the recordings and the model")
    add_settings(parser)
    parser.add_argument("--participant", type=name, metavar="NAME", help="who touches; asked if missing")
    parser.add_argument(
        "--rounds", type=within(int, 1, 10), default=ROUNDS, metavar="N", help="of each gesture (%(default)s)"
    )
    parser.add_argument(
        "--other", action="store_true", help="also record touches that are none of the gestures, as other"
    )


def main(options: argparse.Namespace) -> int:
    """Record, adapt and report; returns 0, 1 when stopped before."""
    found = settings_of(options)
    # If torch is missing, fail before recording, not after.
    with Console(stderr=True).status("loading torch"):
        import torch  # noqa: F401

        from touchd.model.adapt.adapt import adapt_folder
        from touchd.model.adapt.folder import check_output, files_of, read_file
        from touchd.model.adapt.report import is_better, report_lines

    console = Console(width=text_width(), highlight=False, markup=False)
    prepare_folder(options.folder)
    name_of_folder = options.folder.resolve().name
    numbered = (options.folder / f"{name_of_folder}-{number}.onnx" for number in range(1, 1000))
    output = next(path for path in numbered if not path.exists())
    check_output(output)
    for path in files_of(options.folder):
        read_file(path)
    try:
        _record(console, options, found.settings)
        console.print("\nLearning from them takes about a minute.")
        adapted = adapt_folder(options.folder, output)
        for line in report_lines(adapted):
            console.print(line)
        better = is_better(adapted.comparison)
        console.print(how_to_use(output.resolve(), found.file, options.pad, is_better=better), soft_wrap=True)
    except (Stopped, KeyboardInterrupt):
        console.print("\nStopped. What was kept is safe; the same command continues from here.")
        return INCOMPLETE
    return 0


def _record(console: Console, options: argparse.Namespace, settings: Settings) -> None:
    """Make the missing recordings; raises Stopped."""
    participant = options.participant or ask_name(console, "Who touches the pad?")
    session = Session(
        options.folder,
        Setting(participant),
        tuple(HOW) if options.other else GESTURES,
        options.rounds,
        SECONDS,
        tuple(HOW_ONCE),
        flowing=True,
        names={gesture: name_of(words_of(settings), gesture) for gesture in HOW},
    )
    if not session.missing():
        console.print(
            f"{options.folder} has all recordings of {participant}; another person needs another name"
        )
        return
    with PadReader(settings, load_model(settings)) as pad:
        console.print(
            f"{len(session.takes())} recordings follow one another: hands off, then the gesture until the "
            f"bar is full ({SECONDS + 2 * EDGE_S:g} s), or once. q stops."
        )
        Dialogue(console, pad, session).run()


def how_to_use(model: Path, config: Path | None, pad: str | None, *, is_better: bool) -> str:
    """Return how to set a model in a configuration; the service's model must be copied first."""
    lines = [f"\nThe new model is {model}"]
    if config is not None and config.resolve().parent == SERVICE_FOLDER:
        # The service cannot read homes.
        lines.append(f"Copy it: sudo install -m 644 {shlex.quote(str(model))} {SERVICE_FOLDER}/")
        model = SERVICE_FOLDER / model.name
    place = f"{config or 'touchd.yaml'}{f', under sensors.{pad}' if pad else ''}"
    value = json.dumps(str(model), ensure_ascii=False)
    if not is_better:
        lines.append("It is not known to be better: keep the model that you have, or record more.")
    use = "To use it" if is_better else "To use it all the same"
    return "\n".join([*lines, f"{use}, set in {place}:\n", f"model: {value}"])
