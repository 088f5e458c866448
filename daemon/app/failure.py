"""How a command ends that fails: with one line on standard error, and an exit code."""

import errno
import os
import re
import socket
import sys

from touchd.drivers.errors import TouchdError, one_line
from touchd.drivers.installed import SIZES, extra_of, how_to_install

NOT_THERE = re.compile(r"(\S+\.so\S*): cannot open shared object file")
USERS_MISTAKE, OUR_MISTAKE = 2, 1


def discard_output() -> None:
    """Discard buffered output, so that flushing it at exit raises nothing."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def complain(error: Exception) -> int:
    """Write one line about an error that a command raised; returns the exit code."""
    what, code = str(error), USERS_MISTAKE
    if isinstance(error, ModuleNotFoundError) and (extra := extra_of(error.name or "")):
        # As a comment: the line's end may be pasted into a shell.
        size = f"  # {SIZES[extra]} on the disk" if extra in SIZES else ""
        what = f"{error.name} is not installed (extra {extra}): {how_to_install(extra)}{size}"
    elif isinstance(error, ImportError) and (library := NOT_THERE.search(str(error))):
        what = f"{library[1]}, a library of the system, is not there; install the package that brings it"
    elif isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        discard_output()
        what = f"{error.filename or 'standard output'}: cannot be written ({error.strerror})"
    elif isinstance(error, OSError) and error.errno in (errno.EACCES, errno.ENAMETOOLONG):
        what = f"{error.filename}: {error.strerror}; give another path, or put sudo before the command"
    elif isinstance(error.__cause__, socket.gaierror) and error.__cause__.errno == socket.EAI_AGAIN:
        # The network is not up yet: systemd starts the service again.
        code = OUR_MISTAKE
    elif not isinstance(error, TouchdError):
        what = " ".join(f"internal error: {type(error).__name__}: {error}; --debug shows the trace".split())
        if os.environ.get("PYTHONPATH"):
            # Labs set it for ROS or NAOqi; it puts other versions of libraries before those installed.
            what += "; PYTHONPATH is set: try again after `unset PYTHONPATH`"
        code = OUR_MISTAKE
    sys.stderr.write(f"touchd: {one_line(what)}\n")
    return code
