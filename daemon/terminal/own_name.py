"""The name by which this very program can be called again, to be printed in commands for pasting."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from pathlib import Path

PROGRAM = "touchd"


def own_name() -> str:
    """Return "touchd" where the shell finds this program by it, else a path or `python -m daemon`."""
    beside = Path(sys.executable).with_name(PROGRAM)
    found = shutil.which(PROGRAM)
    if found is not None and os.path.realpath(found) == os.path.realpath(beside):
        return PROGRAM
    if beside.exists():
        return shlex.quote(short(beside))
    return f"{shlex.quote(sys.executable)} -m daemon"


def short(path: Path) -> str:
    """Return a path as it is best typed here: from the working directory where it lies in it."""
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)
