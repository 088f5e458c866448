"""The settings of one pad, for a command that works on one."""

import argparse
import sys

from touchd.daemon.commands.settings import Found, add_config, find_settings
from touchd.daemon.config import only_pad


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
