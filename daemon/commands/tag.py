"""`touchd tag`: puts tags into the events of a daemon that runs on this computer."""

import argparse
import sys
from pathlib import Path

from touchd.daemon.sinks.tags import TagError, changed, in_words, read_tags, running_daemons, write_tags
from touchd.drivers.errors import one_line, os_errors_as

DESCRIPTION = (
    "Puts tags into every event of the touchd that runs on this computer, until it ends. "
    "Prints the tags that then hold. If several run, -c chooses one."
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "tags", nargs="*", metavar="KEY=VALUE", help="as in participant=P07; KEY= removes a tag"
    )
    parser.add_argument("-c", "--config", type=Path, metavar="FILE", help="of the daemon with these settings")


def main(options: argparse.Namespace) -> int:
    """Set the tags, and print those that hold; returns 0."""
    # Report a mistake in a tag before a missing daemon.
    changed({}, options.tags)
    wanted = str(options.config.resolve()) if options.config else None
    running = {file: one for file, one in running_daemons().items() if wanted in (None, one.config)}
    if not running:
        which = "no touchd with these settings" if wanted else "no touchd of yours"
        raise TagError(
            f"{which} runs on this computer; start it, or give the tags to `touchd run --tag`; if another "
            "user started it, put sudo before the command"
        )
    if len(running) > 1:
        each = "; ".join(
            f"{one.config or 'the defaults'} (pad at {', '.join(one.ports)})" for one in running.values()
        )
        raise TagError(f"{len(running)} touchd run on this computer; choose one with -c FILE: {each}")
    (file,) = running
    with os_errors_as(TagError, f"{file}: the tags cannot be changed", "has touchd just ended?"):
        tags = changed(read_tags(file), options.tags)
        if options.tags:
            write_tags(file, tags)
    sys.stdout.write(f"tags: {one_line(in_words(tags))}\n")
    return 0
