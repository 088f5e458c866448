"""The description of a pad: what it sends, and how it is mounted."""

import re
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.drivers.errors import TouchdError
from touchd.drivers.frame import COLUMNS, MAX_COUNT, ROWS, Counts

SHORTEST_SIDE, LONGEST_SIDE = 4, 64
Side = Annotated[int, msgspec.Meta(ge=SHORTEST_SIDE, le=LONGEST_SIDE)]
Few = Annotated[int, msgspec.Meta(ge=0, le=64)]
# The largest value of a cell; a float has no relevant limit.
CELL_TOP = {"u8": 255, "i8": 127, "u12": 4095, "u16": 65535, "i16": 32767}

Values = NDArray[np.generic]
"""The cells of a frame as sent, in order: unsigned, signed or float."""


class RawFrame(NamedTuple):
    """A well-formed frame before its clock, range and layout are applied.

    stamp: its clock, None without one. values: (cells,). highest: of the values. host_s: when its last byte
    arrived.
    """

    stamp: float | None
    values: Values
    highest: float
    host_s: float


class FormatError(TouchdError, ValueError):
    """A description contradicts itself; the message says which setting and why."""


class SentFormat(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """How a pad's bytes become pressure; docs/pads.md explains each key.

    A binary frame is header, clock (uint32), skip, cells, tail, checksum; bytes that end a frame belong to
    the next one's header. A frame of text is one line of all cells, or several lines with equally many
    numbers; skip and tail are numbers of each line, and the first one skipped in a line of all cells is its
    clock. Values above full_scale are cut to it, negative ones to 0.
    """

    framing: Literal["text", "binary"] = "binary"
    rows: Side = 10
    columns: Side = 10
    skip: Few = 0
    tail: Few = 0
    end: str = ""
    header: str = ""
    clock: Literal["none", "ms", "us", "s"] = "none"
    cell: Literal["u8", "i8", "u12", "u16", "i16", "f32"] = "u16"
    order: Literal["little", "big"] = "little"
    checksum: Literal["none", "values", "sum8", "xor8"] = "none"
    full_scale: Annotated[float, msgspec.Meta(gt=0, le=4e9)] = MAX_COUNT
    invert: bool = False
    crop: Annotated[int, msgspec.Meta(ge=0, le=28)] = 0

    def __post_init__(self) -> None:
        rows, columns = self.used
        if not all(SHORTEST_SIDE <= side <= LONGEST_SIDE for side in self.used):
            left = f"{self.rows}x{self.columns} with crop {self.crop} leaves {rows}x{columns}"
            raise FormatError(f"{left}; a side of {SHORTEST_SIDE} to {LONGEST_SIDE} must be left")
        others = ("header", "cell", "order", "checksum") if self.framing == "text" else ("end",)
        for name in others:
            if name in msgspec.to_builtins(self):
                raise FormatError(f"{name} is not for a {self.framing} format; leave it out")
        if self.framing == "text":
            if self.has_clock and not self.skip:
                raise FormatError("clock is the first number that skip leaves out: set skip to 1 or more")
        elif not re.fullmatch(r"(\s*[0-9a-fA-F]{2})*", self.header):
            raise FormatError(f"header {self.header!r} is not bytes in hex, as in 'aa ab ac'")
        elif self.full_scale > CELL_TOP.get(self.cell, self.full_scale):
            raise FormatError(f"full_scale {self.full_scale:g} does not fit into a cell of {self.cell}")

    def __str__(self) -> str:
        # Only a header identifies a pad: any pad may send lines of numbers.
        presets = (name for name, preset in PRESETS.items() if self.header and preset.header == self.header)
        return f"{next(presets, self.framing)} {self.rows}x{self.columns}"

    @property
    def has_clock(self) -> bool:
        """Whether frames carry a clock."""
        return self.clock != "none"

    @property
    def cells(self) -> int:
        """Values in a frame."""
        return self.rows * self.columns

    @property
    def used(self) -> tuple[int, int]:
        """Rows and columns that `crop` leaves."""
        return self.rows - 2 * self.crop, self.columns - 2 * self.crop

    @property
    def header_bytes(self) -> bytes:
        """The bytes that a frame begins with."""
        return bytes.fromhex(self.header)


class PadFormat(SentFormat, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """What a pad sends, and how it is mounted: turned clockwise by degrees, then left and right swapped."""

    turn: Literal[0, 90, 180, 270] = 0
    mirror: bool = False


PRESETS = {
    "fabric-grid": PadFormat(header="ffffffff", clock="ms", checksum="values", invert=True, crop=1),
    "csv": PadFormat(framing="text", skip=1, clock="ms", invert=True, crop=1),
    "csv12": PadFormat(framing="text", skip=1, clock="ms", rows=8, columns=8, full_scale=4095),
    "muca": PadFormat(framing="text", rows=12, columns=21, full_scale=255),
    "velostat": PadFormat(framing="text", rows=8, columns=8),
    "m1616": PadFormat(header="aaabac", order="big", rows=16, columns=16),
}


class Layout:
    """Resamples a grid to (8, 8) pressure: by area if the grid is finer, by interpolation if coarser."""

    def __init__(self, described: PadFormat) -> None:
        self._format = described
        scale = np.float32(MAX_COUNT / described.full_scale)
        self._rows = _resampling(described.rows, described.crop, ROWS)
        self._columns = _resampling(described.columns, described.crop, COLUMNS).T * scale

    def pressure(self, values: Values) -> Counts:
        """Turn values (cells,) from 0 to full_scale into pressure (8, 8) uint16, read-only."""
        described = self._format
        cells = values.reshape(described.rows, described.columns).astype(np.float32)
        # Two small products: one large matrix would be evicted from the cache between frames.
        laid = self._rows @ cells @ self._columns
        if described.invert:
            laid = MAX_COUNT - laid
        if described.turn:
            laid = np.rot90(laid, -described.turn // 90)
        if described.mirror:
            laid = laid[:, ::-1]
        counts: Counts = np.asarray(np.rint(laid), np.uint16, order="C")
        counts.flags.writeable = False
        return counts


def _resampling(side: int, crop: int, wanted: int) -> NDArray[np.float32]:
    """Return (wanted, side): the weight of each row (or column) of cells in each row of taxels."""
    left = side - 2 * crop
    edges, cells = np.arange(wanted + 1) * left / wanted, np.eye(left)
    if left >= wanted:
        up_to = [np.interp(edges, np.arange(left + 1), np.cumsum([0, *cell])) for cell in cells]
        shares = np.diff(up_to) * wanted / left
    else:
        centres = (edges[1:] + edges[:-1] - 1) / 2
        shares = np.array([np.interp(centres, np.arange(left), cell) for cell in cells])
    return np.pad(shares.T, ((0, 0), (crop, crop))).astype(np.float32)
