"""The program `touchd`; where it is not on the PATH, `python -m touchd.daemon` runs it too."""

import os
import signal
import sys
from typing import NoReturn

# Until the command's modules are imported, Ctrl-C ends the program at once, without a traceback.
if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
# The kernel drops signals without a handler for process 1, which touchd is in a container.
if os.getpid() == 1:
    for early in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(early) is signal.SIG_DFL:
            signal.signal(early, lambda number, _: os._exit(128 + number))

from touchd.daemon.app.cli import main


def program() -> NoReturn:
    """Run the command line, and exit with its code."""
    code = main()
    # A second Ctrl-C must not print a traceback while the interpreter shuts down.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.default_int_handler:
            signal.signal(number, signal.SIG_DFL)
    sys.exit(code)


if __name__ == "__main__":
    program()
