"""`touchd tag`: puts tags into the events of a daemon that runs on this computer."""

import argparse
import os
import re
import socket
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec

from touchd.daemon.sinks.tags import (
    ADDRESS,
    ANSWER_WITHIN_S,
    MOST_BYTES,
    Reply,
    TagError,
    changed,
    in_words,
    peer_of,
)
from touchd.drivers.errors import os_errors_as

NAMES = Path("/proc/net/unix")
NAME = re.compile(re.escape(ADDRESS.replace("\0", "@").format(pid="")) + r"(\d+)$", re.MULTILINE)


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd tag",
        description="Puts tags into every event of the touchd that runs on this computer, until it ends. "
        "Prints the tags that then hold.",
    )
    parser.add_argument(
        "tags",
        nargs="*",
        metavar="KEY=VALUE",
        help="as in participant=P07; KEY= removes a tag",
    )
    parser.add_argument("--pid", type=int, help="the process of the daemon, if several run")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Set the tags, and print those that hold; returns 0."""
    options = parser().parse_args(arguments)
    # Report a mistake in a tag before a missing daemon.
    changed({}, options.tags)
    with os_errors_as(TagError, f"{NAMES}: cannot be read", "give the tags to `touchd run --tag`"):
        running = sorted({int(pid) for pid in NAME.findall(NAMES.read_text())})
    if options.pid is not None:
        running = [pid for pid in running if pid == options.pid]
    replies = {pid: reply for pid in running if (reply := _request(pid, [])) is not None}
    if not replies and running:
        raise TagError("touchd runs as another user; put sudo before the command")
    if not replies and options.pid is not None:
        raise TagError(f"process {options.pid} is not a running touchd; leave out --pid if only one runs")
    if not replies:
        raise TagError("no touchd runs on this computer; start it, or give the tags to `touchd run --tag`")
    if len(replies) > 1:
        which = "; ".join(f"{pid} (tags: {in_words(reply.tags)})" for pid, reply in replies.items())
        raise TagError(f"{len(replies)} touchd run on this computer; choose one with --pid: {which}")
    (pid,) = replies
    reply = _request(pid, options.tags)
    if reply is None:
        raise TagError("touchd has just ended; start it again, with the tags after --tag")
    if reply.error:
        raise TagError(reply.error)
    sys.stdout.write(f"tags: {in_words(reply.tags)}\n")
    return 0


def _request(pid: int, tags: list[str]) -> Reply | None:
    """Send tags to a daemon; return its reply, None if it does not reply to this user.

    Raises TagError if it hangs.
    """
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
            connection.settimeout(2 * ANSWER_WITHIN_S)
            connection.connect(ADDRESS.format(pid=pid))
            # Anybody may have taken this name.
            if os.geteuid() not in (0, peer_of(connection)[1]):
                return None
            connection.send(msgspec.json.encode(tags))
            return msgspec.json.decode(connection.recv(MOST_BYTES), type=Reply)
    except TimeoutError as error:
        raise TagError(
            f"touchd, process {pid}, does not answer; try again, or choose another with --pid"
        ) from error
    except (OSError, msgspec.DecodeError):
        return None
