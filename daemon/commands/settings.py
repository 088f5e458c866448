"""Finds the configuration of a command."""

import argparse
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from touchd.daemon.app.config import Settings, load
from touchd.drivers.errors import PathError, written_out

NAME = "touchd.yaml"
SERVICE_FOLDER = Path("/etc/touchd")


class Found(NamedTuple):
    """Settings, and their file; None for the defaults. closed: a skipped file that only root can read."""

    settings: Settings
    file: Path | None
    closed: Path | None = None

    def __str__(self) -> str:
        """Say which settings these are."""
        if self.file is not None:
            return f"settings: {self.file.absolute()}"
        closed = f"; {self.closed} can be read only with sudo" if self.closed else ""
        return f"settings: the defaults{closed}"


def add_config(parser: argparse.ArgumentParser, what: str = "settings") -> None:
    found = f"the first {NAME} here, in ~/.config/touchd, in {SERVICE_FOLDER}; defaults without any"
    parser.add_argument("-c", "--config", type=Path, metavar="FILE", help=f"{what}; without it, {found}")


def parsed(parser: argparse.ArgumentParser, arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the arguments of a command without positional ones; a stray word is usually the configuration."""
    options, stray = parser.parse_known_args(arguments)
    if stray:
        advice = "" if stray[0].startswith("-") else f"; a configuration follows -c, as in -c {stray[0]}"
        parser.error(f"unrecognized arguments: {' '.join(stray)}{advice}")
    return options


def find_settings(given: Path | None) -> Found:
    """Return the settings of the given file, else of the first file found in the usual places.

    Raises ConfigError.
    """
    if given is not None:
        return Found(load(given), given)
    own = [Path(NAME)]
    # In a container, a user may have no home.
    with suppress(PathError):
        own.append(written_out(os.environ.get("XDG_CONFIG_HOME") or "~/.config") / "touchd" / NAME)
    for path in own:
        if path.exists():
            return Found(load(path), path)
    service = SERVICE_FOLDER / NAME
    if os.access(service, os.R_OK):
        return Found(load(service), service)
    is_hidden = SERVICE_FOLDER.exists() and not os.access(SERVICE_FOLDER, os.X_OK)
    return Found(Settings(), None, service if is_hidden or os.path.exists(service) else None)
