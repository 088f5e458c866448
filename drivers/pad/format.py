"""What a pad sends, described rather than programmed: framing, cells, clock, checksum, orientation."""

from functools import lru_cache
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.drivers.errors import TouchdError
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, ROWS, Counts

Side = Annotated[int, msgspec.Meta(ge=4, le=64)]
LONGEST_SIDE = 32
CELL_BITS = {"u8": 8, "u12": 12, "u16": 16}
PLAIN_CELLS = {
    ("u8", "little"): "u1",
    ("u8", "big"): "u1",
    ("u16", "little"): "<u2",
    ("u16", "big"): ">u2",
}
# The bits of a packed cell in the order in which they come.
U12_BITS = {"little": np.arange(12, dtype=np.uint16), "big": np.arange(12, dtype=np.uint16)[::-1]}

Grid = NDArray[np.float32]


class FormatError(TouchdError, ValueError):
    """A description contradicts itself; the message says which setting and why."""


class PadFormat(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """How a pad's bytes become pressure.

    framing: "line" (text, all cells on a line, perhaps after a clock in ms), "rows" (text, a row a line, and
    a line with `end` after each frame), or "binary".
    header, footer: bytes that begin or end a binary frame, in hex as in "aa ab ac".
    clock: milliseconds since boot, uint32, follow the header. cell: u8, u16, or u12 (two in three bytes).
    order: of the bytes in clock and cells. checksum: a last byte: "values" sums the cells and the clock,
    "sum8" and "xor8" take all bytes after the header.
    poll: bytes to ask for each frame with, in hex, for a pad that only answers. rate_hz: of the pad.
    rows, columns: the grid as sent. full_scale: the largest value of a cell. invert: that value means no
    pressure. crop: cells left out on every side. turn: degrees to turn the pad by, clockwise. mirror: left
    and right are swapped after that.
    """

    framing: Literal["line", "rows", "binary"] = "binary"
    rows: Side = 10
    columns: Side = 10
    header: str = ""
    footer: str = ""
    end: str = ""
    clock: bool = False
    cell: Literal["u8", "u12", "u16"] = "u16"
    order: Literal["little", "big"] = "little"
    checksum: Literal["none", "values", "sum8", "xor8"] = "none"
    poll: str = ""
    rate_hz: Annotated[float, msgspec.Meta(ge=20, le=500)] = FRAME_RATE_HZ
    full_scale: Annotated[int, msgspec.Meta(ge=1, le=65535)] = MAX_COUNT
    invert: bool = False
    crop: Annotated[int, msgspec.Meta(ge=0, le=28)] = 0
    turn: Literal[0, 90, 180, 270] = 0
    mirror: bool = False

    def __post_init__(self) -> None:
        for name in ("header", "footer", "poll"):
            try:
                bytes.fromhex(getattr(self, name))
            except ValueError:
                raise FormatError(
                    f"{name} {getattr(self, name)!r} is not bytes in hex, as in 'aa ab ac'"
                ) from None
        left = (self.rows - 2 * self.crop, self.columns - 2 * self.crop)
        if not all(4 <= side <= LONGEST_SIDE for side in left):
            raise FormatError(
                f"{self.rows}x{self.columns} with crop {self.crop} leaves {left[0]}x{left[1]}; "
                f"a side of 4 to {LONGEST_SIDE} must be left: change rows, columns or crop"
            )
        if self.framing == "binary" and not (self.header or self.footer or self.poll):
            raise FormatError(
                "a binary format needs a header, a footer or a poll: nothing else tells frames apart"
            )
        if self.framing == "binary" and self.full_scale >= 1 << CELL_BITS[self.cell]:
            raise FormatError(f"full_scale {self.full_scale} does not fit into a cell of {self.cell}")

    def __str__(self) -> str:
        alike = (name for name, preset in PRESETS.items() if preset.line == self.line)
        return f"{next(alike, self.framing)} {self.rows}x{self.columns}"

    @property
    def line(self) -> tuple[object, ...]:
        """The line's format, without the grid and its values."""
        cells = (self.cell, self.order, self.checksum, self.poll)
        return (self.framing, self.header, self.footer, self.end, self.clock, *cells)

    @property
    def cells(self) -> int:
        """Values in a frame."""
        return self.rows * self.columns

    @property
    def first_bytes(self) -> bytes:
        """The bytes before every frame but perhaps the first: the previous one's footer and its header."""
        return bytes.fromhex(self.footer) + bytes.fromhex(self.header)

    @property
    def frame_bytes(self) -> int:
        """Length of a binary frame."""
        cells = -(-self.cells * CELL_BITS[self.cell] // 8)
        return len(self.first_bytes) + 4 * self.clock + cells + (self.checksum != "none")


PRESETS = {
    "fabric-grid": PadFormat(header="ffffffff", clock=True, checksum="values", invert=True, crop=1),
    "csv": PadFormat(framing="line", invert=True, crop=1),
    "csv12": PadFormat(framing="line", rows=8, columns=8, full_scale=4095),
    "muca": PadFormat(framing="line", rows=12, columns=21, full_scale=255),
    "velostat": PadFormat(framing="rows", rows=8, columns=8),
    "m1616": PadFormat(header="aaabac", order="big", rows=16, columns=16),
    "itas": PadFormat(poll="41", cell="u8", rows=8, columns=8, full_scale=255),
    "fsr-array": PadFormat(poll="41", rows=8, columns=8),
}


class Layout:
    """Lays a grid onto (8, 8) pressure, by area where it is finer, interpolated where coarser, and back."""

    def __init__(self, described: PadFormat) -> None:
        self._format = described
        inner = (
            _resampling(described.rows, described.crop, ROWS),
            _resampling(described.columns, described.crop, COLUMNS),
        )
        # (8, 8, cells): the share of each cell in each taxel.
        shares = np.einsum("ij,kl->ikjl", *inner).reshape(ROWS, COLUMNS, described.cells)
        shares = np.rot90(shares, -described.turn // 90)
        if described.mirror:
            shares = shares[:, ::-1]
        self._shares: Grid = np.ascontiguousarray(shares.reshape(ROWS * COLUMNS, -1), dtype=np.float32)
        self._scale = np.float32(MAX_COUNT / described.full_scale)
        # The cell of each taxel, if each taxel is one cell in counts.
        is_plain = self._scale == 1 and np.count_nonzero(self._shares) == ROWS * COLUMNS
        self._cells = self._shares.argmax(axis=1).reshape(ROWS, COLUMNS) if is_plain else None

    def pressure(self, values: NDArray[np.uint16]) -> Counts:
        """Turn values (cells,) as sent into pressure (8, 8) uint16, read-only."""
        counts: Counts
        if self._cells is not None:
            counts = values.take(self._cells)
            if self._format.invert:
                counts = MAX_COUNT - counts
        else:
            laid = (self._shares @ values.astype(np.float32)) * self._scale
            if self._format.invert:
                laid = MAX_COUNT - laid
            counts = np.rint(laid).astype(np.uint16).reshape(ROWS, COLUMNS)
        counts.flags.writeable = False
        return counts

    def values(self, counts: Counts) -> NDArray[np.uint16]:
        """Turn pressure (8, 8) into values (rows, columns) that decode to it; cropped cells are at rest."""
        described = self._format
        turned = np.rot90(counts[:, ::-1] if described.mirror else counts, described.turn // 90)
        left = (described.rows - 2 * described.crop, described.columns - 2 * described.crop)
        at = [np.arange(side) * 8 // side for side in left]
        grid = np.pad(turned[np.ix_(*at)], described.crop)
        if described.invert:
            grid = MAX_COUNT - grid
        values: NDArray[np.uint16] = np.rint(grid * (described.full_scale / MAX_COUNT)).astype(np.uint16)
        return values


@lru_cache(maxsize=32)
def layout_of(described: PadFormat) -> Layout:
    """Return the layout of a format, made once."""
    return Layout(described)


def _resampling(side: int, crop: int, wanted: int) -> Grid:
    """Return (wanted, side): the share of each line of cells in each line of taxels."""
    left = side - 2 * crop
    shares = np.zeros((wanted, side))
    for line in range(wanted):
        if left >= wanted:
            start, stop = line * left / wanted, (line + 1) * left / wanted
            cells = np.arange(left)
            overlap = np.minimum(stop, cells + 1) - np.maximum(start, cells)
            shares[line, crop : crop + left] = np.maximum(overlap, 0) * wanted / left
        else:
            at = min(max((line + 0.5) * left / wanted - 0.5, 0), left - 1)
            below = min(int(at), left - 2)
            shares[line, crop + below : crop + below + 2] = 1 - (at - below), at - below
    return shares.astype(np.float32)


def encode_frame(described: PadFormat, counts: Counts, sensor_ms: int | None) -> bytes:
    """Return pressure (8, 8) as the pad would send it; sensor_ms: None leaves a line's clock out."""
    return encode_values(described, layout_of(described).values(counts), sensor_ms)


def encode_values(described: PadFormat, values: NDArray[np.uint16], sensor_ms: int | None) -> bytes:
    """Return values (rows, columns) as the pad would send them."""
    if described.framing == "line":
        numbers = [*([] if sensor_ms is None else [sensor_ms % 2**32]), *values.ravel().tolist()]
        return ",".join(map(str, numbers)).encode() + b"\n"
    if described.framing == "rows":
        lines = [",".join(map(str, row)) for row in values.tolist()]
        return "\n".join([*lines, described.end, ""]).encode()
    time = (sensor_ms or 0) % 2**32 if described.clock else 0
    body = time.to_bytes(4, described.order) if described.clock else b""
    body += encode_cells(described, values.ravel())
    if described.checksum != "none":
        body += bytes([checksum(described, body, int(values.sum()) + time)])
    return bytes.fromhex(described.header) + body + bytes.fromhex(described.footer)


def checksum(described: PadFormat, body: bytes, total: int) -> int:
    """Return the checksum of the bytes after the header, whose cells and clock sum up to `total`."""
    match described.checksum:
        case "values":
            return total & 0xFF
        case "xor8":
            return int(np.bitwise_xor.reduce(np.frombuffer(body, np.uint8)))
    return sum(body) & 0xFF


def decode_cells(described: PadFormat, data: bytes) -> NDArray[np.uint16]:
    """Return the values (cells,) of a binary frame's cells."""
    if described.cell != "u12":
        kind = PLAIN_CELLS[described.cell, described.order]
        plain: NDArray[np.uint16] = np.frombuffer(data, kind).astype(np.uint16, copy=False)
        return plain
    bits = np.unpackbits(np.frombuffer(data, np.uint8), count=12 * described.cells, bitorder=described.order)
    values: NDArray[np.uint16] = (bits.reshape(-1, 12) << U12_BITS[described.order]).sum(
        axis=1, dtype=np.uint16
    )
    return values


def encode_cells(described: PadFormat, values: NDArray[np.uint16]) -> bytes:
    """Return values (cells,) as a binary frame holds them."""
    if described.cell != "u12":
        return values.astype(PLAIN_CELLS[described.cell, described.order]).tobytes()
    bits = values[:, None] >> U12_BITS[described.order] & 1
    return np.packbits(bits.astype(np.uint8), bitorder=described.order).tobytes()
