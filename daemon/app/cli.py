"""The command `touchd`: runs a subcommand, and turns every error into one line and an exit code."""

import argparse
import difflib
import errno
import importlib
import io
import logging
import os
import signal
import socket
import sys
from collections.abc import Sequence
from importlib import metadata
from types import ModuleType

from touchd.drivers.errors import DISK_FULL, TouchdError, goes_to_systemd, one_line
from touchd.drivers.installed import SIZES, extra_of, how_to_install, program_name

USERS_MISTAKE, OUR_MISTAKE, INTERRUPTED = 2, 1, 130
# These run until a signal ends them; their exit code is then 0.
UNTIL_ENDED = ("run", "demo", "fake-pad", "fake-robot")

COMMANDS = {
    "init": "finds the pad, asks for the robot, writes a configuration",
    "run": "the daemon: reads the pad, reports touches to the robot",
    "demo": "runs the daemon on a simulated pad, then ends",
    "tag": "puts tags such as participant=P07 into a daemon's events",
    "fake-pad": "simulates a pad and prints the path of its port",
    "fake-robot": "simulates a robot and prints every call",
    "classify": "prints the answers to recordings, without a port",
    "record": "guides you through making recordings",
    "teach": "records your gestures and adapts the model, in five minutes",
    "train": "adapts the model to recordings of your own",
    "plot": "draws recordings as a picture",
    "convert": "writes a journal as CSV, a journal or a recording as MCAP",
    "config": "prints an example configuration, every setting explained",
    "docs": "prints a page of the documentation",
    "doctor": "checks pad, model and robot; says what to do",
    "bench": "measures latency, processor, memory and start-up",
}
"""What each subcommand does; its module in `commands` is imported only when it is called."""


def module_of(command: str) -> ModuleType:
    return importlib.import_module(f"touchd.daemon.commands.{command.replace('-', '_')}")


def options_of(command: str, words: Sequence[str]) -> argparse.Namespace:
    """Parse a command's options; raises SystemExit on --help, and if they are wrong."""
    module = module_of(command)
    parser = argparse.ArgumentParser(prog=f"touchd {command}", description=module.DESCRIPTION)
    module.add_options(parser)
    options, stray = parser.parse_known_args(words)
    if stray:
        is_file = hasattr(options, "config") and not stray[0].startswith("-")
        advice = f"; a configuration follows -c, as in -c {stray[0]}" if is_file else ""
        parser.error(f"unrecognized arguments: {' '.join(stray)}{advice}")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a subcommand; returns 0, 2 for the user's mistakes, 1 for ours, 130 when a signal cut it short."""
    given = sys.argv[1:] if arguments is None else arguments
    words = [word for word in given if word != "--debug"]
    logging.getLogger().setLevel(logging.DEBUG if "--debug" in given else logging.INFO)
    ended = 0 if words[:1] and words[0] in UNTIL_ENDED else INTERRUPTED
    _prepare_streams()
    try:
        code = _run(words)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return ended
    except BrokenPipeError:
        discard_output()
        return 0
    except Exception as error:
        # Ctrl-C during the import of a compiled module, or while a thread waits for a lock, is wrapped in
        # another error.
        before = error.__context__ if isinstance(error, RuntimeError) else error.__cause__
        if isinstance(before, KeyboardInterrupt):
            return ended
        if "--debug" in given:
            raise
        return complain(error)


def _run(words: Sequence[str]) -> int:
    if not words or words[0] not in COMMANDS:
        return _answer(words)
    name, *rest = words
    command = module_of(name)
    # After the import, which could swallow it: signals raise KeyboardInterrupt, so that commands clean up.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    return int(command.main(options_of(name, rest)))


def _prepare_streams() -> None:
    """Open /dev/null for closed standard streams, so that no other file gets their descriptors.

    Replace characters that the terminal's encoding lacks, in input and output.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - stays open
        if isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _answer(words: Sequence[str]) -> int:
    """Print help or version; returns the exit code. Raises TouchdError for an unknown command."""
    if not words or words[0] in ("-h", "--help", "help"):
        sys.stdout.write(_help())
        return 0 if words else USERS_MISTAKE
    if words[0] in ("--version", "version"):
        sys.stdout.write(f"touchd {metadata.version('touchd')}\n")
        return 0
    near = difflib.get_close_matches(words[0].lower(), COMMANDS, n=1)
    advice = f"did you mean {near[0]}?" if near else f"there are {', '.join(COMMANDS)}"
    raise TouchdError(f"{words[0]} is not a command; {advice}")


def _help() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  touchd {name:<{width}}  {what}" for name, what in COMMANDS.items()]
    first = "touchd recognises social touch on a pressure pad and reports it to a Nao robot within a second."
    last = f"{program_name()} COMMAND --help says more; --debug shows the trace of an error, and logs more."
    return "\n".join([first, "", *lines, "", last, ""])


def discard_output() -> None:
    """Discard buffered output, so that flushing it at exit raises nothing."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def complain(error: Exception) -> int:
    """Write one line about an error that a command raised; returns the exit code."""
    what, code = _explained(error)
    level = "<3>" if goes_to_systemd(2) else ""
    sys.stderr.write(f"{level}touchd: {one_line(what)}\n")
    return code


def _explained(error: Exception) -> tuple[str, int]:
    """Return an error in words, and the exit code for it."""
    if isinstance(error, TouchdError):
        # This computer has no such address or no name server yet: let systemd restart the service.
        is_early = getattr(error.__cause__, "errno", None) in (errno.EADDRNOTAVAIL, socket.EAI_AGAIN)
        return str(error), OUR_MISTAKE if is_early else USERS_MISTAKE
    if isinstance(error, ModuleNotFoundError) and (extra := extra_of(error.name or "")):
        # A shell comment, as the command may be pasted with it.
        size = f"  # {SIZES[extra]} on the disk" if extra in SIZES else ""
        return f"{error.name} is not installed (extra {extra}): {how_to_install(extra)}{size}", USERS_MISTAKE
    if isinstance(error, OSError) and error.errno in DISK_FULL:
        discard_output()
        return f"{error.filename or 'standard output'}: cannot be written ({error.strerror})", USERS_MISTAKE
    if isinstance(error, OSError) and error.errno in (errno.EACCES, errno.ENAMETOOLONG):
        advice = "give another path, or put sudo before the command"
        return f"{error.filename}: {error.strerror}; {advice}", USERS_MISTAKE
    if isinstance(error, UnicodeEncodeError) and error.encoding == "utf-8":
        # Only arguments and the names of files have such characters.
        return "an argument or a file's name is not UTF-8; rename the file, or type it again", USERS_MISTAKE
    what = " ".join(f"internal error: {type(error).__name__}: {error}; --debug shows the trace".split())
    if os.environ.get("PYTHONPATH"):
        # Labs set it for ROS or NAOqi; it makes Python import other versions of libraries.
        what += "; PYTHONPATH is set: try again after `unset PYTHONPATH`"
    return what, OUR_MISTAKE
