"""Other programs, run to their end or started."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

from rigs.wait import WITHIN_S

TOUCHD = (sys.executable, "-m", "touchd.daemon")
# Makes every extra's modules fail to import.
WITHOUT_EXTRAS = """
import importlib, importlib.abc, sys
from touchd.drivers.installed import EXTRAS
class Missing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {module for modules in EXTRAS.values() for module in modules}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Missing())
from touchd.daemon.app import cli
"""


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

    def __exit__(self, kind: type[BaseException] | None, *error: Any) -> None:
        # After a failed assertion nobody stops the program any more.
        if kind is not None:
            self.kill()
        super().__exit__(kind, *error)
