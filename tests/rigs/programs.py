"""Other programs, run to their end."""

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rigs.wait import WITHIN_S


def ran(command: Sequence[str | Path], **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a program to its end: exit status, output and errors as text."""
    return subprocess.run(
        command, capture_output=True, text=True, **({"check": False, "timeout": WITHIN_S} | options)
    )
