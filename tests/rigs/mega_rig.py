"""The sketch, compiled for an Arduino Mega and run on a simulated one that is wired to a simulated pad."""

import json
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import MAX_COUNT

FIRMWARE = Path(__file__).parents[2] / "drivers" / "firmware"
SKETCH = FIRMWARE / "fabric_grid" / "fabric_grid.ino"
HARNESS = Path(__file__).parent / "simulated_mega.c"
ARDUINO_CORE = Path("/usr/share/arduino/hardware/arduino/avr")
SIMAVR = Path("/usr/include/simavr")
SUPPLY_MV = 5000


def compiler_missing() -> bool:
    """Whether the sketch cannot be compiled for the Mega here."""
    tools = map(shutil.which, ("avr-g++", "make"))
    return not (all(tools) and ARDUINO_CORE.is_dir())


def simulator_missing() -> bool:
    """Whether the compiled sketch cannot be run here."""
    return compiler_missing() or shutil.which("cc") is None or not SIMAVR.is_dir()


def build(folder: Path, rows: int = 10, columns: int = 10, baud: int = 512_000) -> Path:
    """Compile the sketch with these settings; warnings are errors. `folder` is shared by all of them."""
    settings = [f"BUILD={folder}", f"ROWS={rows}", f"COLUMNS={columns}", f"BAUD={baud}"]
    subprocess.run(["make", "--silent", "-C", FIRMWARE, *settings], check=True)
    return folder / f"{rows}x{columns}-{baud}" / "fabric_grid.elf"


def build_board(folder: Path) -> Path:
    """Compile the simulated board that runs the sketch."""
    board = folder / "simulated_mega"
    flags = ["-O2", "-Wall", "-Wextra", "-Werror", f"-I{SIMAVR}"]
    subprocess.run(["cc", *flags, HARNESS, "-o", board, "-lsimavr"], check=True)
    return board


@dataclass(frozen=True)
class Board:
    """A simulated Mega that runs the sketch.

    rows, columns: as compiled. Its pins read raw values (pictures, rows, columns), one picture per scan,
    repeating.
    """

    program: Path
    sketch: Path
    folder: Path
    rows: int
    columns: int

    def run(self, pictures: NDArray[np.uint16], seconds: float) -> "Run":
        """Run it for `seconds` of its own time; return what it sent and when."""
        path = self.folder / "pictures"
        path.write_bytes(_millivolts(pictures).astype("<u2").tobytes())
        command = [self.program, self.sketch, path, *map(str, (self.rows, self.columns, seconds))]
        done = subprocess.run(command, capture_output=True)
        said = done.stderr.decode()
        assert done.returncode == 0, said
        figures = json.loads(said.splitlines()[-1])
        return Run(sent=done.stdout, **figures | {"began_ms": np.array(figures["began_ms"])})


@dataclass(frozen=True)
class Run:
    """What a board sent, and times by its crystal: when each scan began, how long the first one took to its
    last reading and to its last sent byte, and the least time between switching a row and reading it."""

    sent: bytes
    began_ms: NDArray[np.float64]
    scan_ms: float
    until_sent_ms: float
    least_settling_us: float

    def raw(self, rows: int, columns: int) -> NDArray[np.uint16]:
        """The raw values (frames, rows, columns) of a run that was not cut off within a frame."""
        size = 9 + 2 * rows * columns
        frames = np.frombuffer(self.sent, np.uint8).reshape(-1, size)
        return np.ascontiguousarray(frames[:, 8:-1]).view(np.uint16).reshape(-1, rows, columns)


def _millivolts(raw: NDArray[np.uint16]) -> NDArray[np.int64]:
    """The lowest voltage that the Mega's converter reads as that value."""
    return -(-raw.astype(np.int64) * SUPPLY_MV // MAX_COUNT)
