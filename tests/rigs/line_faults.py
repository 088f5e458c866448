"""Faults of a serial line, injected at fixed intervals."""

import itertools
import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Counts
from touchd.drivers.recording import Stream

# The checksum detects every bit flipped in the low bytes of a fabric-grid frame's values.
FIRST_LOW_BYTE = 8


@dataclass(frozen=True)
class Faults:
    """Which frames are damaged: every n-th for each kind, 0 for none; reproducible.

    flip_bit_every: a bit is flipped where the checksum sees it. drop_frame_every: the frame is not sent.
    repeat_frame_every: it is sent twice. cut_frame_every: it ends early. garbage_every: random bytes come
    first. chunk_bytes: bytes per write, 0 for a frame per write.
    """

    flip_bit_every: int = 0
    drop_frame_every: int = 0
    repeat_frame_every: int = 0
    cut_frame_every: int = 0
    garbage_every: int = 0
    chunk_bytes: int = 0

    def on_line(self, number: int, packet: bytes) -> bytes:
        """Return what the line carries in place of the encoded frame `number`."""
        if not packet or _falls_on(number, self.drop_frame_every):
            return b""
        chance = random.Random(number)
        if _falls_on(number, self.flip_bit_every):
            flipped = bytearray(packet)
            flipped[chance.randrange(FIRST_LOW_BYTE, len(packet), 2)] ^= 1 << chance.randrange(8)
            packet = bytes(flipped)
        if _falls_on(number, self.cut_frame_every):
            packet = packet[: chance.randrange(1, len(packet) - 1)]
        if _falls_on(number, self.repeat_frame_every):
            packet += packet
        if _falls_on(number, self.garbage_every):
            packet = chance.randbytes(chance.randrange(1, 100)) + packet
        return packet


NO_FAULTS = Faults()


class FaultyPort(FakePort):
    """A fake port on a faulty line."""

    def __init__(
        self,
        stream: Stream,
        encode: Callable[[Counts, int], bytes],
        *,
        faults: Faults = NO_FAULTS,
        **options: Any,
    ) -> None:
        super().__init__(stream, encode, **options)
        self._faults = faults
        self._numbers = itertools.count()

    def _send(self, index: int, packet: bytes) -> None:
        packet = self._faults.on_line(next(self._numbers), packet)
        size = self._faults.chunk_bytes or len(packet) or 1
        for start in range(0, len(packet), size):
            super()._send(index, packet[start : start + size])


def _falls_on(number: int, every: int) -> bool:
    return every > 0 and number % every == every - 1
