"""The report's results in one JSON file, each with how it was made."""

import fcntl
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from touchd.drivers.errors import TouchdError
from touchd.drivers.whole_file import whole_file
from touchd.model.studies.checks.timing import Timing

LIBRARIES = ("numpy", "onnxruntime", "torch", "scikit-learn")


class ResultsError(TouchdError):
    """The file of results cannot be read; the message says what to do."""


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """One measured cell. seconds: how long measuring it took; commit: the code's, "+" when it was changed."""

    values: dict[str, Any]
    seconds: float
    command: str
    commit: str
    machine: str
    date: str


class Results:
    """The cells in one file, by keys such as "table3/public/frames54/seed0"; processes may add at once."""

    def __init__(self, path: Path) -> None:
        """Take the file's path; the file need not be there yet."""
        self.path = path
        # As of the process's start: that code runs, whatever is committed meanwhile.
        self.commit = commit()

    def has(self, key: str) -> bool:
        """Return whether the cell is there."""
        return key in self._read()

    def get(self, key: str) -> dict[str, Any]:
        """Return a cell's values; raises KeyError when it is not there."""
        return self.cell(key).values

    def cell(self, key: str) -> Cell:
        """Return a cell with how it was made; raises KeyError when it is not there."""
        return self._read()[key]

    def keys(self, prefix: str = "") -> list[str]:
        """Return the keys that begin with `prefix`, sorted."""
        return sorted(key for key in self._read() if key.startswith(prefix))

    def put(self, key: str, values: dict[str, Any], seconds: float) -> None:
        """Add a cell, or replace it, and write the file whole or not at all; the others' cells stay."""
        cell = Cell(
            values=values,
            seconds=round(seconds, 3),
            command=command(),
            commit=self.commit,
            machine=machine(),
            date=datetime.now(timezone.utc).strftime("%Y-%m-%d"),
        )
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # The folder is locked, as a lock on the file would be lost when it is replaced.
        folder = os.open(self.path.parent, os.O_RDONLY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
            cells = {**self._read(), key: cell}
            # One line a cell, so that a change to one cell is a change to one line.
            lines = [b": ".join(map(msgspec.json.encode, (name, cells[name]))) for name in sorted(cells)]
            with whole_file(self.path) as partial:
                partial.write_bytes(b"{\n" + b",\n".join(lines) + b"\n}\n")
        finally:
            os.close(folder)

    def put_together(self, measured: Mapping[str, dict[str, Any]], began_s: float) -> None:
        """Put cells that were measured in one run, which began then by `time.perf_counter`."""
        for key, values in measured.items():
            self.put(key, values, (time.perf_counter() - began_s) / len(measured))

    def _read(self) -> dict[str, Cell]:
        try:
            return msgspec.json.decode(self.path.read_bytes(), type=dict[str, Cell])
        except FileNotFoundError:
            return {}
        except (OSError, msgspec.DecodeError) as error:
            raise ResultsError(f"{self.path}: no file of results ({error}); move it away") from error


@dataclass(frozen=True)
class Study:
    """haart: folder of recordings; runs: of checkpoints; docs: of the page; threads: of the processor."""

    haart: Path
    runs: Path
    results: Results
    threads: int
    docs: Path

    @property
    def checkpoints(self) -> Path:
        """Where the parts keep unfinished work."""
        return self.runs / "report"


def percent(shares: Sequence[float]) -> str:
    """Return the mean share in percent, "± sd" after it where there are several; "" for none."""
    if not shares:
        return ""
    mean = f"{100 * np.mean(shares):.1f}"
    return f"{mean} ± {100 * np.std(shares, ddof=1):.1f}" if len(shares) > 1 else mean


def timing_values(timing: Timing) -> dict[str, float]:
    """Return a timing as a cell keeps it."""
    return {name: round(getattr(timing, name), 4) for name in ("p50_ms", "p99_ms", "processor_ms")}


def command() -> str:
    """Return the command line that this process was started with, folders by their last names only."""
    program = Path(sys.argv[0])
    name = program.parent.name if program.name == "__main__.py" else program.name
    return " ".join([name, *(Path(word).name if "/" in word else word for word in sys.argv[1:])])


def commit() -> str:
    """Return the short hash of the code's commit, "+" after it when a source file differs; "" without git."""
    root = Path(__file__).parents[3]

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no", "--", "model", "drivers")
        return git("rev-parse", "--short=8", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return ""


def machine() -> str:
    """Return the processor, as Linux names it, its cores and the libraries' versions."""
    try:
        named = re.search(r"^model name\s*:\s*(.+)", Path("/proc/cpuinfo").read_text("utf-8"), re.MULTILINE)
    except OSError:
        named = None
    processor = named[1].strip() if named else platform.machine()
    versions = [
        f"{name} {found.version}" for name in LIBRARIES for found in metadata.distributions(name=name)
    ]
    cores, python = f"{os.cpu_count()} cores", f"Python {platform.python_version()}"
    return ", ".join([processor, cores, python, *versions])
