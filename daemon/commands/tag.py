"""`touchd tag`: puts tags into the events of a daemon that runs on this computer."""

import argparse
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
        "Prints the tags that then hold. If several run, choose one as it was started, by -c or --port.",
    )
    parser.add_argument(
        "tags",
        nargs="*",
        metavar="KEY=VALUE",
        help="as in participant=P07; KEY= removes a tag",
    )
    parser.add_argument("-c", "--config", type=Path, metavar="FILE", help="of the daemon with these settings")
    parser.add_argument("--port", help="of the daemon that reads this port")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Set the tags, and print those that hold; returns 0."""
    options = parser().parse_args(arguments)
    # Report a mistake in a tag before a missing daemon.
    changed({}, options.tags)
    running = _running(options.config, options.port)
    if len(running) > 1:
        which = "; ".join(map(str, running.values()))
        raise TagError(
            f"{len(running)} touchd run on this computer; choose one with -c FILE or --port PORT: {which}"
        )
    (path,) = running
    reply = _request(path, options.tags)
    if reply is None:
        raise TagError("touchd has just ended; start it again, with the tags after --tag")
    if reply.error:
        raise TagError(reply.error)
    sys.stdout.write(f"tags: {one_line(in_words(reply.tags))}\n")
    return 0


def _running(config: Path | None, port: str | None) -> dict[Path, Reply]:
    """Return the sockets of the daemons that run with these settings, and what they say; raises TagError."""
    wanted = str(config.resolve()) if config is not None else None
    is_anothers = False
    running: dict[Path, Reply] = {}
    for path in sockets():
        try:
            reply = _request(path, [])
        except PermissionError:
            is_anothers = True
            continue
        if reply and wanted in (None, reply.config) and port in (None, *reply.pads.values()):
            running[path] = reply
    if not running and is_anothers:
        raise TagError("touchd runs as another user; put sudo before the command")
    if not running:
        which = "no touchd with these settings" if config or port else "no touchd of yours"
        raise TagError(
            f"{which} runs on this computer; start it, or give the tags to `touchd run --tag`; if another "
            "user started it, put sudo before the command"
        )
    return running


def _request(path: Path, tags: list[str]) -> Reply | None:
    """Send tags to a daemon; return its reply, None if it has ended.

    Raises TagError if it hangs, PermissionError if it is another user's.
    """
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
            connection.settimeout(2 * ANSWER_WITHIN_S)
            connection.connect(str(path))
            connection.send(msgspec.json.encode(tags))
            return msgspec.json.decode(connection.recv(MOST_BYTES), type=Reply)
    except TimeoutError as error:
        raise TagError(
            f"the touchd behind {path} does not answer; try again, or choose another with -c or --port"
        ) from error
    except PermissionError:
        raise
    except (OSError, msgspec.DecodeError):
        return None
