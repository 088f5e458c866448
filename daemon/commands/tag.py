"""`touchd tag`: puts tags into the events of a daemon that runs on this computer."""

import argparse
import os
import socket
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec

from touchd.daemon.sinks.tags import ANSWER_WITHIN_S, MOST_BYTES, Reply, TagError, changed, in_words, sockets
from touchd.drivers.errors import one_line


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd tag",
        description="Puts tags into every event of the touchd that runs on this computer, until it ends. "
        "Prints the tags that then hold. If several run, -c chooses one.",
    )
    parser.add_argument(
        "tags",
        nargs="*",
        metavar="KEY=VALUE",
        help="as in participant=P07; KEY= removes a tag",
    )
    parser.add_argument("-c", "--config", type=Path, metavar="FILE", help="of the daemon with these settings")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Set the tags, and print those that hold; returns 0."""
    options = parser().parse_args(arguments)
    # Report a mistake in a tag before a missing daemon.
    changed({}, options.tags)
    wanted = str(options.config.resolve()) if options.config else None
    asked = ((path, _request(path, [])) for path in sockets())
    running = {path: reply for path, reply in asked if reply and wanted in (None, reply.config)}
    if not running:
        which = "no touchd with these settings" if wanted else "no touchd of yours"
        raise TagError(
            f"{which} runs on this computer; start it, or give the tags to `touchd run --tag`; if another "
            "user started it, put sudo before the command"
        )
    if len(running) > 1:
        each = "; ".join(
            f"{reply.config or 'the defaults'} (pad at {', '.join(reply.ports)})"
            for reply in running.values()
        )
        raise TagError(f"{len(running)} touchd run on this computer; choose one with -c FILE: {each}")
    (path,) = running
    reply = _request(path, options.tags)
    if reply is None:
        raise TagError("touchd has just ended; start it again, with the tags after --tag")
    if reply.error:
        raise TagError(reply.error)
    sys.stdout.write(f"tags: {one_line(in_words(reply.tags))}\n")
    return 0


def _request(path: Path, tags: list[str]) -> Reply | None:
    """Send tags to a daemon; return its reply, None if it has ended or is another user's.

    Raises TagError if it hangs.
    """
    try:
        # In /tmp, another user may have put a socket that anybody reaches.
        if os.geteuid() not in (0, path.stat().st_uid):
            return None
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
            connection.settimeout(2 * ANSWER_WITHIN_S)
            connection.connect(str(path))
            connection.send(msgspec.json.encode(tags))
            return msgspec.json.decode(connection.recv(MOST_BYTES), type=Reply)
    except TimeoutError as error:
        raise TagError(f"the touchd behind {path} does not answer; try again, or restart it") from error
    except (OSError, msgspec.DecodeError):
        return None
