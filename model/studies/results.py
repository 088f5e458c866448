"""A study's stored results: one JSON file, a line per cell, each cell with its provenance."""

import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar

import msgspec
import numpy as np

from touchd.drivers.errors import TouchdError
from touchd.drivers.whole_file import whole_file
from touchd.model.studies.marked import percent

STORED = Path(__file__).parent / "stored"
LIBRARIES = ("numpy", "onnxruntime", "torch", "scikit-learn")
Figures = TypeVar("Figures", bound=msgspec.Struct)


class ResultsError(TouchdError):
    """The file of results cannot be read; the message says what to do."""


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """One measured cell. seconds: duration of the measurement; commit: of the code, "+" if it was changed."""

    values: dict[str, Any]
    seconds: float
    command: str
    commit: str
    machine: str
    date: str


class Results:
    """The cells of one file by their keys, such as "public/blocks1/frames54/epochs18/seed0"."""

    def __init__(self, path: Path) -> None:
        """Open the file; it need not exist. Raises ResultsError."""
        self.path = path
        # Read at the start, because the files may change while the process runs.
        self.commit = commit()
        self._cells = _read(path)

    def has(self, key: str) -> bool:
        """Return whether the cell exists."""
        return key in self._cells

    def get(self, key: str) -> dict[str, Any]:
        """Return a cell's values; raises KeyError if it does not exist."""
        return self._cells[key].values

    def cell(self, key: str) -> Cell:
        """Return a cell with its provenance; raises KeyError if it does not exist."""
        return self._cells[key]

    def find(self, prefix: str = "") -> list[str]:
        """Return the keys that begin with `prefix`, sorted."""
        return sorted(key for key in self._cells if key.startswith(prefix))

    def put(self, key: str, values: dict[str, Any], seconds: float) -> None:
        """Add or replace a cell, and write the file atomically."""
        self._cells[key] = Cell(
            values=values,
            seconds=round(seconds, 3),
            command=command(),
            commit=self.commit,
            machine=machine(),
            date=datetime.now(timezone.utc).strftime("%Y-%m-%d"),
        )
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # One line per cell, so that a changed cell is one changed line.
        lines = [b": ".join(map(msgspec.json.encode, (name, self._cells[name]))) for name in self.find()]
        with whole_file(self.path) as partial:
            partial.write_bytes(b"{\n" + b",\n".join(lines) + b"\n}\n")

    def measure(self, rows: Iterable[tuple[str, Callable[[], dict[str, Any]]]]) -> None:
        """Measure and store the rows that are not stored yet, and print them to stderr."""
        for key, figures in rows:
            if not self.has(key):
                since = monotonic()
                self.put(key, figures(), monotonic() - since)
                sys.stderr.write(f"{key}: {msgspec.json.encode(self.get(key)).decode()}\n")


def keep(path: Path, measured: msgspec.Struct) -> None:
    """Store the figures of a study that measures all of them at once."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(measured), indent=1) + b"\n")


def stored(path: Path, kind: type[Figures]) -> Figures:
    """Return what `keep` stored."""
    return msgspec.json.decode(path.read_bytes(), type=kind)


def mean_percent(shares: Sequence[float]) -> str:
    """Return the mean share in percent; "" for no share."""
    return percent(float(np.mean(shares))) if shares else ""


def command() -> str:
    """Return this process's command line, with each path reduced to its last name."""
    program = Path(sys.argv[0])
    name = program.parent.name if program.name == "__main__.py" else program.name
    return " ".join([name, *(Path(word).name if "/" in word else word for word in sys.argv[1:])])


def commit() -> str:
    """Return the commit's short hash, with "+" if a source file was changed since; "" without git."""
    root = Path(__file__).parents[2]

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no", "--", "model", "drivers")
        return git("rev-parse", "--short=8", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return ""


def machine() -> str:
    """Return the processor's name in Linux, its cores and the versions of the libraries."""
    try:
        named = re.search(r"^model name\s*:\s*(.+)", Path("/proc/cpuinfo").read_text("utf-8"), re.MULTILINE)
    except OSError:
        named = None
    processor = named[1].strip() if named else platform.machine()
    versions = [
        f"{name} {found.version}" for name in LIBRARIES for found in metadata.distributions(name=name)
    ]
    return ", ".join([processor, f"{os.cpu_count()} cores", f"Python {platform.python_version()}", *versions])


def _read(path: Path) -> dict[str, Cell]:
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Cell])
    except FileNotFoundError:
        return {}
    except (OSError, msgspec.DecodeError) as error:
        raise ResultsError(f"{path}: no file of results ({error}); move it away") from error
