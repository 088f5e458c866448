"""`touchd fake-robot`: a stand-in robot on this computer, to see what a Nao would do."""

import argparse
from collections.abc import Sequence

from drivers.fakes import fake_robot


def parser() -> argparse.ArgumentParser:
    """Return what the command line takes."""
    parser = argparse.ArgumentParser(
        prog="touchd fake-robot",
        description="Real qi services on 127.0.0.1; prints where it listens, then every call, as JSON lines.",
    )
    fake_robot.add_arguments(parser)
    return parser


def main(arguments: Sequence[str]) -> int:
    """Be a robot until Ctrl-C or SIGTERM; every call comes out as one JSON object a line."""
    fake_robot.run(parser().parse_args(arguments))
