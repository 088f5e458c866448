"""The program `touchd`, also `python -m touchd.daemon` wherever the command itself is not on the PATH."""

import signal
import sys
from typing import NoReturn

# Ctrl-C then ends the program at once and without a trace, until the command's modules are imported.
if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from touchd.daemon.cli import main


def program() -> NoReturn:
    """Run the command line, and exit with its code."""
    code = main()
    # A second Ctrl-C must not leave the trace of whatever the interpreter does at its end.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.default_int_handler:
            signal.signal(number, signal.SIG_DFL)
    sys.exit(code)


if __name__ == "__main__":
    program()
