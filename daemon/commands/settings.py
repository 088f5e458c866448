"""Finds the configuration of a command, and the settings of the pad that it works on."""

import argparse
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import msgspec

from touchd.daemon.app.config import ConfigError, SensorSettings, Settings, load
from touchd.drivers.errors import PathError, expand_home

NAME = "touchd.yaml"
SERVICE_FOLDER = Path("/etc/touchd")


class Found(NamedTuple):
    """Settings, and their file; None for the defaults. closed: a skipped file that only root can read."""

    settings: Settings
    file: Path | None
    closed: Path | None = None

    def __str__(self) -> str:
        """Return which settings these are, in words."""
        if self.file is not None:
            return f"settings: {self.file.absolute()}"
        closed = f"; {self.closed} can be read only with sudo" if self.closed else ""
        return f"settings: the defaults{closed}"


def add_config(parser: argparse.ArgumentParser, what: str = "settings") -> None:
    found = f"the first {NAME} here, in ~/.config/touchd, in {SERVICE_FOLDER}; defaults without any"
    parser.add_argument("-c", "--config", type=Path, metavar="FILE", help=f"{what}; without it, {found}")


def find_settings(given: Path | None) -> Found:
    """Return the settings of the given file, else of the first file found in the usual places.

    Raises ConfigError.
    """
    if given is not None:
        return Found(load(given), given)
    own = [Path(NAME)]
    # In a container, a user may have no home.
    with suppress(PathError):
        own.append(expand_home(os.environ.get("XDG_CONFIG_HOME") or "~/.config") / "touchd" / NAME)
    for path in own:
        if path.exists():
            return Found(load(path), path)
    service = SERVICE_FOLDER / NAME
    if os.access(service, os.R_OK):
        return Found(load(service), service)
    is_hidden = SERVICE_FOLDER.exists() and not os.access(SERVICE_FOLDER, os.X_OK)
    return Found(Settings(), None, service if is_hidden or os.path.exists(service) else None)


def add_settings(parser: argparse.ArgumentParser, what: str = "settings", port: bool = True) -> None:
    add_config(parser, what)
    parser.add_argument("--pad", metavar="NAME", help="the pad to use, if several are configured")
    if port:
        parser.add_argument("--port", help="read this port instead of the configured one")


def settings_of(options: argparse.Namespace) -> Found:
    """Return the settings of the pad that the arguments name, as `sensor`; raises ConfigError.

    Writes the file that was found to standard error if the arguments name none.
    """
    found = find_settings(options.config)
    if options.config is None and (found.file or found.closed):
        sys.stderr.write(f"{found}\n")
    return found._replace(settings=only_pad(found.settings, options.pad, getattr(options, "port", None)))


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
