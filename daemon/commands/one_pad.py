"""The settings of one pad, for a command that works on one."""

import argparse
import sys
import typing

import msgspec

from touchd.daemon.app.config import ConfigError, SensorSettings, Settings
from touchd.daemon.commands.settings import Found, add_config, find_settings

if typing.TYPE_CHECKING:
    from touchd.model.classifier import Classifier


def add_settings(parser: argparse.ArgumentParser, what: str = "settings", port: bool = True) -> None:
    add_config(parser, what)
    parser.add_argument("--pad", metavar="NAME", help="the pad to use, if several are configured")
    if port:
        parser.add_argument("--port", help="read this port instead of the configured one")


def settings_of(options: argparse.Namespace) -> Found:
    """Return the settings of the pad that the arguments name, as `sensor`; raises ConfigError.

    Says on standard error which file was found if the arguments name none.
    """
    found = find_settings(options.config)
    if options.config is None and (found.file or found.closed):
        sys.stderr.write(f"{found}\n")
    return found._replace(settings=only_pad(found.settings, options.pad, getattr(options, "port", None)))


def load_model(settings: Settings) -> "Classifier":
    """Load the only pad's model; see `load_models`."""
    # Other commands need no network, which takes long to import.
    from touchd.daemon.app.parts import load_models

    (model,) = load_models(settings).values()
    return model


def only_pad(settings: Settings, name: str | None, port: str | None = None) -> Settings:
    """Return the settings of one pad, at another port if given. name: needed if there are several pads.

    Raises ConfigError when there is no such pad, or the name is missing.
    """
    pads = settings.pads
    chosen = pads.get(name) if name else next(iter(pads.values())) if len(pads) == 1 else None
    if chosen is None:
        wrong = f"{name}: no pad has this name" if name else "several pads are configured"
        raise ConfigError(f"{wrong}; give --pad one of {', '.join(pads)}")
    if port is None:
        return chosen
    try:
        # Construct it: replace() would not check the values.
        sensor = SensorSettings(**(msgspec.structs.asdict(chosen.sensor) | {"port": port}))
    except ValueError as error:
        raise ConfigError(f"--port: {error}") from error
    return msgspec.structs.replace(chosen, sensor=sensor)
