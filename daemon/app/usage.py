"""What `touchd` answers without a command: its help, its version, or which command may be meant."""

import difflib
import sys
from collections.abc import Mapping, Sequence
from importlib import metadata

from touchd.drivers.errors import TouchdError
from touchd.drivers.installed import program_name

USERS_MISTAKE = 2


class UsageError(TouchdError):
    """The command line names an unknown command."""


def answer(words: Sequence[str], commands: Mapping[str, str]) -> int:
    """Print help or version; returns the exit code. commands: the help of each. Raises UsageError."""
    if not words or words[0] in ("-h", "--help", "help"):
        sys.stdout.write(_help(commands))
        return 0 if words else USERS_MISTAKE
    if words[0] in ("--version", "version"):
        sys.stdout.write(f"touchd {metadata.version('touchd')}\n")
        return 0
    near = difflib.get_close_matches(words[0].lower(), commands, n=1)
    advice = f"did you mean {near[0]}?" if near else f"there are {', '.join(commands)}"
    raise UsageError(f"{words[0]} is not a command; {advice}")


def _help(commands: Mapping[str, str]) -> str:
    width = max(map(len, commands))
    lines = [f"  touchd {name:<{width}}  {what}" for name, what in commands.items()]
    first = "touchd recognises social touch on a pressure pad and reports it to a Nao robot within a second."
    last = f"{program_name()} COMMAND --help says more; --debug with any command shows the trace of an error."
    return "\n".join([first, "", *lines, "", last, ""])
