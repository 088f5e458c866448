"""The settings of a command for one pad: those of a pad in a file, perhaps at another port."""

import argparse
from pathlib import Path

from touchd.daemon.config import Settings, load, only_pad


def add_settings(
    parser: argparse.ArgumentParser, config: str = "settings; defaults without it", port: bool = True
) -> None:
    parser.add_argument("-c", "--config", type=Path, metavar="FILE", help=config)
    parser.add_argument("--pad", metavar="NAME", help="the pad to use, if several are configured")
    if port:
        parser.add_argument("--port", help="read this port instead of the configured one")


def settings_of(options: argparse.Namespace) -> Settings:
    """Return the settings of the pad that the arguments name, as `sensor`; raises ConfigError."""
    settings = load(options.config) if options.config else Settings()
    return only_pad(settings, options.pad, getattr(options, "port", None))
