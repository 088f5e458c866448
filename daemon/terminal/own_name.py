"""The name by which the shell finds this program, for commands to paste."""

import os
import shlex
import shutil
import sys
from pathlib import Path

PROGRAM = "touchd"


def own_name() -> str:
    """Return "touchd" if the shell finds this program by it, else a path, short if it is near."""
    beside = Path(sys.executable).with_name(PROGRAM)
    found = shutil.which(PROGRAM)
    if found is not None and os.path.realpath(found) == os.path.realpath(beside):
        return PROGRAM
    if beside.exists():
        here = Path.cwd()
        return shlex.quote(str(beside.relative_to(here) if beside.is_relative_to(here) else beside))
    return f"{shlex.quote(sys.executable)} -m touchd.daemon"
