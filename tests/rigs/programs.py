"""Other programs, run to their end or started."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

from rigs.wait import WITHIN_S

TOUCHD = (sys.executable, "-m", "touchd.daemon")


def ran(command: Sequence[str | Path], **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a program to its end: exit status, output and errors as text."""
    return subprocess.run(
        command, capture_output=True, text=True, **({"check": False, "timeout": WITHIN_S} | options)
    )


class Program(subprocess.Popen[str]):
    """A started program whose output can be read as text."""

    stdout: IO[str]

    def __init__(self, *command: str | Path, **options: Any) -> None:
        super().__init__(command, stdout=subprocess.PIPE, text=True, **options)
