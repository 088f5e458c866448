"""The name by which the shell finds this program, for commands to paste."""

import os
import shlex
import shutil
import sys
from pathlib import Path

PROGRAM = "touchd"


def own_name() -> str:
    """Return "touchd" if the shell finds this program by it, else a path or `python -m daemon`."""
    beside = Path(sys.executable).with_name(PROGRAM)
    found = shutil.which(PROGRAM)
    if found is not None and os.path.realpath(found) == os.path.realpath(beside):
        return PROGRAM
    if beside.exists():
        return shlex.quote(short(beside))
    return f"{shlex.quote(sys.executable)} -m daemon"


def short(path: Path) -> str:
    """Return a path relative to the working directory if it lies within."""
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)
