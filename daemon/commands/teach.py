"""`touchd teach`: adapts the model to a person in five minutes; needs the extra `train`."""

import argparse
import json
import re
import shlex
import shutil
from collections.abc import Sequence
from pathlib import Path

import yaml
from rich.console import Console

from touchd.daemon.app.config import ConfigError, Settings, load
from touchd.daemon.app.parts import load_models
from touchd.daemon.commands.one_pad import add_settings, only_pad, settings_of
from touchd.daemon.commands.record import INCOMPLETE, LONGEST_S, SHORTEST_S
from touchd.daemon.commands.settings import SERVICE_FOLDER
from touchd.daemon.record.capture import PadReader
from touchd.daemon.record.dialogue import GESTURES, HOW, HOW_ONCE, Dialogue, Terms
from touchd.daemon.record.session import Session, Setting, ask_name, name
from touchd.daemon.robot.words import name_of, words_of
from touchd.daemon.view.terminal import Stopped, ask, text_width
from touchd.drivers.errors import TouchdError, os_errors_as
from touchd.drivers.installed import program_name
from touchd.drivers.numbers import within
from touchd.drivers.recording import prepare
from touchd.drivers.whole_file import whole_file

ROUNDS = 2
# With a trimmed second at each end and the countdown, fourteen recordings take 2.5 minutes; four touches made
# once take half a minute.
SECONDS = 6.0
SINGLES = tuple(HOW_ONCE)
COUNTDOWN_S = 2.0


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd teach",
        description="Records every gesture twice, and a single pat and stroke, adapts the shipped model to "
        "the recordings, prints how often it was right before and after, and sets the new model. Repeat the "
        "command if interrupted.",
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder for the recordings and the model")
    add_settings(parser, "settings, in which the new model is set")
    parser.add_argument("--participant", type=name, metavar="NAME", help="who touches; asked if missing")
    parser.add_argument(
        "--rounds", type=within(int, 1, 10), default=ROUNDS, metavar="N", help="of each gesture (%(default)s)"
    )
    parser.add_argument(
        "--seconds",
        type=within(float, SHORTEST_S, LONGEST_S),
        default=SECONDS,
        help="of each recording (%(default)g)",
    )
    parser.add_argument(
        "--other", action="store_true", help="also record touches that are none of the gestures, as other"
    )
    return parser


def main(arguments: Sequence[str]) -> int:
    """Record, adapt, report, and set the model; returns 0, 1 when stopped before."""
    options = parser().parse_args(arguments)
    found = settings_of(options)
    # If torch is missing, fail before recording, not after.
    with Console(stderr=True).status("loading torch"):
        from touchd.model.adapt.folder import files_of, read_file
        from touchd.model.adapt.head import AdaptSettings
        from touchd.model.adapt.output import check_output
        from touchd.model.adapt.report import report_lines, verdict
        from touchd.model.adapt.ship import adapt_folder

    console = Console(width=text_width(), highlight=False, markup=False)
    prepare(options.folder)
    output = _free_name(options.folder, options.folder.resolve().name)
    check_output(output)
    for path in files_of(options.folder):
        read_file(path)
    try:
        _record(console, options, found.settings)
        console.print("\nLearning from them takes about a minute.")
        adapted = adapt_folder(options.folder, output, AdaptSettings())
        words = words_of(found.settings)
        for line in report_lines(adapted, {label: name_of(words, label) for label in adapted.labels}):
            console.print(line)
        console.print(f"\nThe new model is {output}")
        is_better = verdict(adapted.comparison) == "better"
        put_into_use(console, found.file, output, options.pad, is_better=is_better)
    except (Stopped, KeyboardInterrupt):
        console.print("\nStopped. What was kept is safe; the same command continues from here.")
        return INCOMPLETE
    return 0


def with_model(text: str, model: Path, pad: str | None = None) -> str:
    """Return the text of a configuration with `model:` set and everything else unchanged.

    pad: the one of several pads whose model is set.
    """
    value = json.dumps(str(model), ensure_ascii=False)
    root = yaml.compose(text, yaml.SafeLoader)
    pads = _section(root, "sensors")
    own = _section(pads, pad)
    if pads is not None and own is None:
        raise ConfigError(f"sensors: {pad} has no setting beside which to set its model")
    at = own or root
    for key, old in at.value if isinstance(at, yaml.MappingNode) else ():
        if key.value == "model":
            return f"{text[: key.end_mark.index]}: {value}{text[old.end_mark.index :]}"
    line = f"model: {value}"
    if own is not None:
        first = own.value[0][0].start_mark
        end = ", " if own.flow_style else "\n" + " " * first.column
        return f"{text[: first.index]}{line}{end}{text[first.index :]}"
    changed, count = re.subn(r"^# ?model:.*$", lambda _: line, text, count=1, flags=re.MULTILINE)
    return changed if count else f"{text.rstrip()}\n{line}\n"


def _section(node: yaml.Node | None, name: str | None) -> yaml.MappingNode | None:
    """Return a section of a mapping, None if it is missing or empty."""
    sections = {key.value: value for key, value in node.value} if isinstance(node, yaml.MappingNode) else {}
    section = sections.get(name)
    return section if isinstance(section, yaml.MappingNode) and section.value else None


def _record(console: Console, options: argparse.Namespace, settings: Settings) -> None:
    """Make the missing recordings; raises Stopped."""
    participant = options.participant or ask_name(console, "Who touches the pad?")
    gestures = tuple(HOW) if options.other else GESTURES
    session = Session(options.folder, Setting(participant), gestures, options.rounds, SINGLES)
    if not session.missing():
        console.print(
            f"{options.folder} has all recordings of {participant}; another person needs another name"
        )
        return
    with PadReader(settings) as pad:
        console.print(
            f"{len(session.takes())} recordings follow one another: hands off, then the gesture until the "
            f"bar is full ({options.seconds:g} s), or once. q stops."
        )
        names = {gesture: name_of(words_of(settings), gesture) for gesture in HOW}
        terms = Terms(options.seconds, COUNTDOWN_S, "not stated", flowing=True, names=names)
        Dialogue(console, pad, settings, session, terms).run()


def _free_name(folder: Path, name: str) -> Path:
    return next(path for n in range(1, 1000) if not (path := folder / f"{name}-{n}.onnx").exists())


def put_into_use(
    console: Console, config: Path | None, model: Path, pad: str | None = None, *, is_better: bool
) -> None:
    """Ask, then set the model in the configuration, for one pad if `pad` names it.

    Raises Stopped, and ConfigError if the model does not fit the configuration, which then stays unchanged.
    """
    model = model.resolve()
    if config is None:
        console.print(f"To use it, set `model: {model}` in touchd.yaml.")
        return
    pad = pad or next(iter(load(config).sensors), None)
    if not _is_wanted(console, config, is_better=is_better):
        return
    is_service = config.resolve().parent == SERVICE_FOLDER
    again = "run the same command with sudo; it does not record again"
    advice = again if is_service else f"set `model: {model}` in it yourself"
    with os_errors_as(ConfigError, f"{config}: cannot be written", advice):
        copy = _beside(model) if is_service else None
        # Resolve a symlink, so that its target is replaced and not the link.
        with whole_file(config.resolve()) as new:
            settings = _write_changed(new, config, copy or model, pad)
            _check_models(settings, config, copy)
    by_service = "sudo systemctl restart touchd"
    by_hand = f"{program_name()} run -c {shlex.quote(str(config))}"
    console.print(f"Set. To use it now: {by_service if is_service else by_hand}")


def _is_wanted(console: Console, config: Path, *, is_better: bool) -> bool:
    """Ask whether to use the model; one that is not known to be better only if asked for."""
    if is_better:
        question = f"Enter to use it from now on (in {config}), n to leave the configuration as it is: "
        return ask(console, question, ("", "n")) == ""
    question = f"Enter to leave the configuration as it is, u to use it from now on (in {config}): "
    return ask(console, question, ("", "u")) == "u"


def _write_changed(new: Path, config: Path, model: Path, pad: str | None) -> Settings:
    """Write a configuration with the model set to a new file, and load it; raises ConfigError."""
    by_hand = ConfigError(f"{config} stays as it was; set `model: {model}` in it yourself")
    try:
        # As bytes, to keep line ends.
        new.write_bytes(with_model(config.read_bytes().decode(), model, pad).encode())
        settings = load(new)
    except (ConfigError, UnicodeDecodeError) as error:
        raise by_hand from error
    if only_pad(settings, pad).model != str(model):
        raise by_hand
    return settings


def _check_models(settings: Settings, config: Path, copy: Path | None) -> None:
    """Raise ConfigError if the models do not fit the settings; remove a copy made for them."""
    try:
        load_models(settings)
    except TouchdError as error:
        if copy is not None:
            copy.unlink()
        raise ConfigError(f"{config} stays as it was; the new model does not fit it: {error}") from error


def _beside(model: Path) -> Path:
    """Copy a model to the service's folder, since the service cannot read homes; raises OSError."""
    copy = _free_name(SERVICE_FOLDER, model.parent.name)
    with whole_file(copy, replace=False) as new:
        shutil.copyfile(model, new)
    return copy
