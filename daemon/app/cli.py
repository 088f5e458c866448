"""The command `touchd`: finds the subcommand, and turns every error into one line and an exit code."""

import importlib
import io
import os
import signal
import sys
from collections.abc import Sequence

INTERRUPTED = 130
# These run until a signal ends them; their exit code is then 0.
UNTIL_ENDED = ("run", "demo", "replay", "fake-pad", "fake-robot")

COMMANDS = {
    "init": "finds the pad, asks for the robot, writes a configuration",
    "run": "the daemon: reads the pad, reports touches to the robot",
    "demo": "runs the daemon on a simulated pad, then ends",
    "tag": "puts tags such as participant=P07 into a daemon's events",
    "replay": "plays recordings through a fake serial port",
    "fake-pad": "simulates a pad and prints the path of its port",
    "fake-robot": "simulates a robot and prints every call",
    "classify": "prints the answers to recordings, without a port",
    "record": "guides you through making recordings",
    "teach": "records your gestures and adapts the model, in three minutes",
    "train": "adapts the model to recordings of your own",
    "plot": "draws recordings, or a journal, as a picture",
    "convert": "writes a journal or a recording as CSV or MCAP",
    "config": "prints an example configuration, every setting explained",
    "docs": "prints a page of the documentation",
    "doctor": "checks pad, model, robot and service; says what to do",
    "bench": "measures latency, processor, memory, start-up and speed",
    "completion": "prints the script for a shell's completion",
}
"""What each subcommand does; its module in `commands` is imported only when it is called."""


def module_of(command: str) -> str:
    return f"touchd.daemon.commands.{command.replace('-', '_')}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a subcommand; returns 0, 2 for the user's mistakes, 1 for ours, 130 when a signal cut it short."""
    given = sys.argv[1:] if arguments is None else arguments
    words = [word for word in given if word != "--debug"]
    ended = 0 if words[:1] and words[0] in UNTIL_ENDED else INTERRUPTED
    _prepare_streams()
    try:
        code = _run(words)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return ended
    except BrokenPipeError:
        # Here and below, import only where needed: at the top, it would delay the daemon's start.
        from touchd.daemon.app.failure import discard_output

        discard_output()
        return 0
    except Exception as error:
        # A compiled module that is interrupted while it is imported raises an error of its own, and so does
        # a lock that is interrupted while a thread waits for it.
        before = error.__context__ if isinstance(error, RuntimeError) else error.__cause__
        if isinstance(before, KeyboardInterrupt):
            return ended
        if "--debug" in given:
            raise
        from touchd.daemon.app.failure import complain

        return complain(error)


def _run(words: Sequence[str]) -> int:
    if not words or words[0] not in COMMANDS:
        from touchd.daemon.app.usage import answer

        return answer(words, COMMANDS)
    name, *rest = words
    command = importlib.import_module(module_of(name))
    # From here on, signals raise KeyboardInterrupt, so that commands clean up; an import could swallow it.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)
    return int(command.main(rest))


def _prepare_streams() -> None:
    """Open /dev/null for closed standard streams, so that no other file gets their number.

    Characters that a terminal's encoding lacks are replaced, both ways.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - stays open
        if isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors="replace")
