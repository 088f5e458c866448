"""What every protocol shares: how a pad's grid becomes pressure, and the count of what was refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.errors import TouchdError
from drivers.frame import COLUMNS, MAX_COUNT, ROWS, Counts, Frame

CLOCK_MODULUS = 2**32


class ProtocolError(TouchdError):
    """A protocol cannot work as configured; the message says which setting and why."""


@dataclass
class ProtocolCounts:
    """What a protocol delivered and refused since it was made.

    Damage between two intact frames is counted once or more, a lone damaged frame mostly once.
    frames: delivered. bad_framing: stretches of up to one frame's length in which no frame begins (a broken
    header, garbage, a malformed line). bad_checksum, bad_value (above 1023), bad_time (disagrees with the
    sensor's clock): frames refused for that. duplicates: frames that repeat a clock already taken.
    bytes_dropped: bytes that belong to no well-formed frame.
    """

    frames: int = 0
    bad_framing: int = 0
    bad_checksum: int = 0
    bad_value: int = 0
    bad_time: int = 0
    duplicates: int = 0
    bytes_dropped: int = 0

    @property
    def bad(self) -> int:
        """Frames refused as damaged, for whatever reason; a duplicate is not damage."""
        return self.bad_framing + self.bad_checksum + self.bad_value + self.bad_time


class Reading(NamedTuple):
    """A well-formed frame whose clock is still to be judged; fields as in `Frame`."""

    sensor_ms: int
    host_s: float
    pressure: Counts


@dataclass(frozen=True)
class Geometry:
    """How a pad's grid of rows x columns raw values becomes the (8, 8) pressure of a frame.

    crop: rings of border taxels left out. invert: raw values fall with pressure (1023 = none), as the fabric
    pad's do. Raises ProtocolError when what is left is not 8x8.
    """

    rows: int
    columns: int
    crop: int
    invert: bool

    def __post_init__(self) -> None:
        left = (self.rows - 2 * self.crop, self.columns - 2 * self.crop)
        if self.crop < 0 or left != (ROWS, COLUMNS):
            raise ProtocolError(
                f"rows {self.rows}, columns {self.columns} and crop {self.crop} leave {left[0]}x{left[1]} "
                f"taxels, touchd needs {ROWS}x{COLUMNS} (a 10x10 pad has crop 1, an 8x8 pad crop 0)"
            )

    @property
    def taxels(self) -> int:
        """Raw values in a frame."""
        return self.rows * self.columns

    def __str__(self) -> str:
        return f"{self.rows}x{self.columns}"

    def pressure(self, raw: NDArray[np.uint16]) -> Counts:
        """Turn raw values (rows * columns,) into pressure (8, 8) uint16: read-only, on its own memory."""
        grid = raw.reshape(self.rows, self.columns)
        inner = grid[self.crop : self.crop + ROWS, self.crop : self.crop + COLUMNS]
        counts = np.array(MAX_COUNT - inner if self.invert else inner, dtype=np.uint16)
        counts.flags.writeable = False
        return counts

    def raw(self, counts: Counts) -> NDArray[np.uint16]:
        """Turn pressure (8, 8) into the raw values (rows, columns) a pad sends; its border feels nothing."""
        grid = np.zeros((self.rows, self.columns), dtype=np.uint16)
        grid[self.crop : self.crop + ROWS, self.crop : self.crop + COLUMNS] = counts
        return np.uint16(MAX_COUNT) - grid if self.invert else grid


def number_frames(readings: list[Reading], counts: ProtocolCounts) -> list[Frame]:
    """Turn accepted readings into frames, numbered on from those delivered before."""
    first = counts.frames
    counts.frames += len(readings)
    return [Frame(number, *reading) for number, reading in enumerate(readings, first)]
