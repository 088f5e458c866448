"""Binary frames: bytes in, frames out, no I/O.

Which frames are intact: read from the left, a window of one frame's length is well-formed if it begins with
the header and its checksum, if any, is right; the sensor's clock, if any, then decides (see `clock.py`).
Require a following header of windows that lost bytes could have made: those with values above full scale
and, without a checksum, those that contain the header again and, if the header is short, the first one after
a gap.
Refusing a window skips only its first byte, so that a true frame that begins inside it is found. Some
damage cannot be detected: the fabric pad's checksum sums low bytes only, so a flip in the upper byte of a
value passes.
"""

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import Frame
from touchd.drivers.pad.format import PadFormat, Values
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.protocol_counts import Damage

# A header this long hardly ever occurs among cells.
LONG_HEADER = 3
CELL_BITS = {"u8": 8, "u12": 12, "u16": 16, "i16": 16, "f32": 32}
PLAIN_CELLS = {
    ("u8", "little"): "u1",
    ("u8", "big"): "u1",
    ("u16", "little"): "<u2",
    ("u16", "big"): ">u2",
    ("i16", "little"): "<i2",
    ("i16", "big"): ">i2",
    ("f32", "little"): "<f4",
    ("f32", "big"): ">f4",
}
# The bits of a packed cell in the order in which they come.
U12_BITS = {"little": np.arange(12, dtype=np.uint16), "big": np.arange(12, dtype=np.uint16)[::-1]}


def frame_bytes(described: PadFormat) -> int:
    """Return the length of a pad's binary frame."""
    cells = -(-described.cells * CELL_BITS[described.cell] // 8)
    around = described.skip + described.tail + (described.checksum != "none")
    return len(described.first_bytes) + 4 * described.clock + cells + around


class BinaryFrames(FrameParser):
    """Parser for frames with a header or a footer; keeps less than two frames' bytes between calls.

    A footer is read as part of the next frame's header, so bytes before the first footer are never used.
    """

    def __init__(self, described: PadFormat) -> None:
        super().__init__(described)
        self._header = described.first_bytes
        self._size = frame_bytes(described)
        self._cells_at = len(self._header) + 4 * described.clock + described.skip
        self._position = 0
        # Bytes still to be dropped that belong to a damaged frame already counted.
        self._claimed = 0
        # The window that began one byte before the position was refused: both lie in one run of header bytes.
        self._in_refused_run = False
        # The window at the position follows a frame directly.
        self._in_step = False

    def _parse(self, data: bytes, host_s: float) -> list[Frame]:
        self._buffer += data
        frames: list[Frame] = []
        while (
            self._position < len(self._buffer)
            and self._seek_header()
            and (taken := self._take(host_s)) is not None
        ):
            frames += taken
        self._buffer = self._buffer[self._position :]
        self._position = 0
        return frames

    def reset(self) -> None:
        super().reset()
        self._claimed = 0
        self._in_refused_run = self._in_step = False

    def damage_in(self, window: bytes) -> Damage | None:
        """Say what is wrong with a whole window that begins with the header; None when it is well-formed."""
        values = self._sound(window)
        return values if isinstance(values, str) else None

    def values_in(self, window: bytes) -> Values:
        """Return the values (cells,) of a whole window."""
        return decode_cells(self.format, window[self._cells_at :])

    def _sound(self, window: bytes) -> Values | Damage:
        """Return the values (cells,) of a well-formed window, or what is wrong with it."""
        described = self.format
        # A quick way through a long run of header bytes. Cells may begin with the bytes of a short header.
        if len(self._header) >= LONG_HEADER and window.startswith(self._header, self._cells_at):
            return "bad_framing"
        values = self.values_in(window)
        if described.cell == "f32" and not np.isfinite(values).all():
            return "bad_value"
        if described.checksum == "none":
            return values
        body = window[len(self._header) : -1]
        total = int(sum(values.tolist())) + (self.time_in(window) if described.clock else 0)
        return "bad_checksum" if checksum(described, body, total) != window[-1] else values

    def _is_followed(self, window: bytes, highest: float) -> bool | None:
        """Whether the next header confirms a window, or need not; None if more bytes are needed to know."""
        header = self._header
        is_sure = self.format.checksum != "none" or (
            window.find(header, 1) < 0 and (self._in_step or len(header) >= LONG_HEADER)
        )
        if not header or (is_sure and highest <= self.format.full_scale):
            return True
        at = self._position + self._size
        after = self._buffer[at : at + len(header)]
        if not header.startswith(after):
            return False
        return True if after == header else None

    def time_in(self, window: bytes) -> int:
        """Return the four bytes after the header of a whole window as its clock."""
        at = len(self._header)
        return int.from_bytes(window[at : at + 4], self.format.order)

    def _seek_header(self) -> bool:
        """Move to the next header, dropping what comes before; False when none is in the buffer."""
        start = self._buffer.find(self._header, self._position)
        if start >= 0:
            self._drop(start - self._position)
            return True
        # The last bytes may be the beginning of a header whose rest is still to come.
        lengths = range(len(self._header) - 1, 0, -1)
        begun = next((n for n in lengths if self._buffer.endswith(self._header[:n], self._position)), 0)
        self._drop(len(self._buffer) - self._position - begun)
        return False

    def _take(self, host_s: float) -> list[Frame] | None:
        """Judge the window at the position; return the frames to deliver, None if bytes are missing."""
        window = self._buffer[self._position : self._position + self._size]
        if len(window) < self._size:
            return None
        values = self._sound(window)
        if isinstance(values, str):
            self._refuse(values)
            return []
        # Caches are cold when the reader wakes: the maximum of a list takes half as long as NumPy's.
        highest = max(values.tolist())
        is_followed = self._is_followed(window, highest)
        if is_followed is None:
            return None
        if not is_followed:
            self._refuse("bad_framing")
            return []
        sensor_ms = self.time_in(window) if self.format.clock else None
        if self._header and sensor_ms is not None and not self.clock.is_on_time(sensor_ms):
            hides_another = self._hides_another()
            if hides_another is None:
                return None
            if hides_another:
                self._refuse("bad_time")
                return []
        self._position += self._size
        self._claimed = 0
        self._in_refused_run = False
        self._in_step = True
        return self._judge(sensor_ms, host_s, values, highest)

    def _hides_another(self) -> bool | None:
        """Whether a well-formed window begins inside the one at the position; None: more bytes are needed.

        If so, the outer one, whose clock jumps, is not a frame.
        """
        inner = self._position
        while (inner := self._buffer.find(self._header, inner + 1, self._position + self._size)) >= 0:
            window = self._buffer[inner : inner + self._size]
            if len(window) < self._size:
                return None
            if self.damage_in(window) is None:
                return True
        return False

    def _refuse(self, damage: Damage) -> None:
        """Refuse the window at the position and skip its first byte; a run of header bytes counts once."""
        if not self._in_refused_run:
            self.counts.refuse(damage)
            self._claimed = self._size
        self._drop(1 if self._header else self._size)
        self._in_refused_run = bool(self._header)

    def _drop(self, count: int) -> None:
        """Skip bytes outside frames; what no refusal covers counts as one lost frame per frame length."""
        if count == 0:
            return
        self._position += count
        self._in_refused_run = self._in_step = False
        self.counts.bytes_dropped += count
        unexplained = count - self._claimed
        lost = max(0, -(-unexplained // self._size))
        self.counts.bad_framing += lost
        self._claimed = lost * self._size - unexplained


class Datagrams(BinaryFrames):
    """Parser for a pad that sends bare cells over UDP: each datagram is a frame, or is refused."""

    def _parse(self, data: bytes, host_s: float) -> list[Frame]:
        if len(data) != self._size:
            if data:
                self.counts.refuse("bad_framing", len(data))
            return []
        return super()._parse(data, host_s)


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
        sent = np.frombuffer(data, PLAIN_CELLS[described.cell, described.order], described.cells)
        return sent if sent.dtype.isnative else sent.astype(sent.dtype.newbyteorder("="))
    bits = np.unpackbits(np.frombuffer(data, np.uint8), count=12 * described.cells, bitorder=described.order)
    values: NDArray[np.uint16] = (bits.reshape(-1, 12) << U12_BITS[described.order]).sum(
        axis=1, dtype=np.uint16
    )
    return values
