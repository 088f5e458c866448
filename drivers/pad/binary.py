"""Finds binary frames in a byte stream: bytes in, values out.

A frame begins with the header, and is accepted once another header follows. Waiting for that header delays a
frame, so it is accepted at once if all its values are within full scale (lost bytes exceed it) and

- its checksum is right, and no frame with a right checksum begins inside it; or
- it has no checksum, directly follows an accepted frame, and does not contain the header again.

Where no frame is accepted, the search goes on one byte later.
"""

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import ProtocolCounts
from touchd.drivers.pad.format import PadFormat, RawFrame, Values

# A header this long hardly ever occurs among cells.
LONG_HEADER = 3
CELL_BITS = {"u8": 8, "i8": 8, "u12": 12, "u16": 16, "i16": 16, "f32": 32}
PLAIN_CELLS = {
    (cell, order): f"{sign}{kind}"
    for cell, kind in (("u8", "u1"), ("i8", "i1"), ("u16", "u2"), ("i16", "i2"), ("f32", "f4"))
    for order, sign in (("little", "<"), ("big", ">"))
}
# The order of the bits in a packed cell.
U12_BITS = {"little": np.arange(12, dtype=np.uint16), "big": np.arange(12, dtype=np.uint16)[::-1]}
CLOCK_BYTES = 4


def frame_bytes(described: PadFormat) -> int:
    """Return the length of a pad's binary frame."""
    cells = -(-described.cells * CELL_BITS[described.cell] // 8)
    around = described.skip + described.tail + (described.checksum != "none")
    return len(described.header_bytes) + CLOCK_BYTES * described.has_clock + cells + around


class BinaryFraming:
    """Finds frames that begin with a header; without one, a datagram of a frame's length is a frame.

    Keeps less than two frames' bytes between calls.
    """

    def __init__(self, described: PadFormat, counts: ProtocolCounts) -> None:
        self._format = described
        self._counts = counts
        self._header = described.header_bytes
        self._size = frame_bytes(described)
        self._cells_at = len(self._header) + CLOCK_BYTES * described.has_clock + described.skip
        self.reset()

    def reset(self) -> None:
        """Drop a partial frame."""
        self.buffer = b""
        # Bytes skipped since the last frame; whether the next byte directly follows a frame.
        self._gap, self._in_step = 0, False

    def feed(self, data: bytes, host_s: float) -> list[RawFrame]:
        """Take the next bytes; return the frames that they completed."""
        if not self._header:
            return self._datagram(data, host_s)
        self.buffer += data
        found: list[RawFrame] = []
        at = 0
        while (at := self._next_header(at)) + self._size <= len(self.buffer):
            window = self.buffer[at : at + self._size]
            values = self._values_in(window)
            raw = None if values is None else self._raw_frame(window, values, host_s)
            is_frame = raw is not None and self._is_confirmed(raw, at)
            if is_frame is None:
                break
            if raw is not None and is_frame:
                found.append(raw)
                at += self._size
                self._gap, self._in_step = 0, True
            else:
                at += self._drop(1)
        self.buffer = self.buffer[at:]
        return found

    def _next_header(self, at: int) -> int:
        """Return where the next header begins, or may begin: its rest is still to come."""
        start = self.buffer.find(self._header, at)
        if start < 0:
            start = max(at, len(self.buffer) - len(self._header) + 1)
        return at + self._drop(start - at)

    def _values_in(self, window: bytes) -> Values | None:
        """Return the values (cells,) of a whole window; None if they cannot be a frame's."""
        described = self._format
        # Skip a long run of header bytes quickly. A short header may also be the first cells.
        if len(self._header) >= LONG_HEADER and window.startswith(self._header, self._cells_at):
            return None
        values = decode_cells(described, window[self._cells_at :])
        if described.cell == "f32" and not np.isfinite(values).all():
            return None
        if described.checksum == "none":
            return values
        total = int(sum(values.tolist())) + (self._time_in(window) if described.has_clock else 0)
        is_right = checksum(described, window[len(self._header) : -1], total) == window[-1]
        return values if is_right else None

    def _is_confirmed(self, raw: RawFrame, at: int) -> bool | None:
        """Whether the well-formed window at `at` is a frame; None until more bytes have arrived."""
        is_summed = self._format.checksum != "none"
        end = at + self._size
        inside = self.buffer.find(self._header, at + 1, end)
        while is_summed and inside >= 0:
            other = self.buffer[inside : inside + self._size]
            if len(other) < self._size:
                return None
            if self._values_in(other) is not None:
                break
            inside = self.buffer.find(self._header, inside + 1, end)
        if inside < 0 and (is_summed or self._in_step) and raw.highest <= self._format.full_scale:
            return True
        after = self.buffer[end : end + len(self._header)]
        if not self._header.startswith(after):
            return False
        return True if after == self._header else None

    def _datagram(self, data: bytes, host_s: float) -> list[RawFrame]:
        """Take a datagram of bare cells: a frame, or refused."""
        values = self._values_in(data) if len(data) == self._size else None
        if values is None:
            self._counts.damaged += bool(data)
            return []
        return [self._raw_frame(data, values, host_s)]

    def _raw_frame(self, window: bytes, values: Values, host_s: float) -> RawFrame:
        stamp = self._time_in(window) if self._format.has_clock else None
        # With the cold caches of a thread that just woke, max() of a list is twice as fast as NumPy's.
        return RawFrame(stamp, values, max(values.tolist()), host_s)

    def _time_in(self, window: bytes) -> int:
        """Return the bytes after the header of a whole window as its clock."""
        at = len(self._header)
        return int.from_bytes(window[at : at + CLOCK_BYTES], self._format.order)

    def _drop(self, count: int) -> int:
        """Count bytes outside frames, as one damaged frame per started frame length; return `count`."""
        if count:
            before = -(-self._gap // self._size)
            self._gap += count
            self._counts.damaged += -(-self._gap // self._size) - before
            self._in_step = False
        return count


def checksum(described: PadFormat, body: bytes, total: int) -> int:
    """Return the checksum of the bytes after the header, whose cells and clock sum up to `total`."""
    match described.checksum:
        case "values":
            return total & 0xFF
        case "xor8":
            return int(np.bitwise_xor.reduce(np.frombuffer(body, np.uint8)))
    return sum(body) & 0xFF


def decode_cells(described: PadFormat, data: bytes) -> Values:
    """Return the values (cells,) of a binary frame's cells, which `data` begins with."""
    if described.cell != "u12":
        stored = np.frombuffer(data, PLAIN_CELLS[described.cell, described.order], described.cells)
        return stored if stored.dtype.isnative else stored.astype(stored.dtype.newbyteorder("="))
    bits = np.unpackbits(np.frombuffer(data, np.uint8), count=12 * described.cells, bitorder=described.order)
    values: NDArray[np.uint16] = (bits.reshape(-1, 12) << U12_BITS[described.order]).sum(
        axis=1, dtype=np.uint16
    )
    return values
