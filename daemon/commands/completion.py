"""`touchd completion`: the script for a shell to complete touchd's commands and options."""

import argparse
import importlib
import sys
from collections.abc import Sequence

import shtab

from touchd.daemon.app.cli import COMMANDS, module_of
from touchd.drivers.installed import PROGRAM, program_name


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd completion",
        description="Writes a completion script to standard output. "
        f'For this shell: eval "$({program_name()} completion bash)"; for good: the same line in ~/.bashrc.',
    )
    parser.add_argument("shell", choices=shtab.SUPPORTED_SHELLS, help="the shell to complete in")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Write the script; returns 0."""
    shell = parser().parse_args(arguments).shell
    whole = argparse.ArgumentParser(prog=PROGRAM)
    commands = whole.add_subparsers()
    for command, what in COMMANDS.items():
        own: argparse.ArgumentParser = importlib.import_module(module_of(command)).parser()
        commands.add_parser(command, parents=[own], add_help=False, help=what)
    sys.stdout.write(f"{shtab.complete(whole, shell)}\n")
    return 0
