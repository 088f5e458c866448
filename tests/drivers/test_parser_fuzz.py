"""The lab's frames of bytes: each intact one arrives once and in order, no damaged one, whatever comes."""

import random
from collections.abc import Callable

import numpy as np
import pytest
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.wire import PERIOD_MS, SIZE, TIME_BITS, VISIBLE_BITS, assert_are, flip, packet, packets

SUMMED_BITS = [bit for bit in VISIBLE_BITS if bit not in TIME_BITS]
# Losing or adding bytes elsewhere may leave the frame intact, for instance if FF bytes precede its header.
INNER_BYTES = range(8, SIZE - 9)


def test_a_10x10_pad_gives_the_8x8_of_haart() -> None:
    raw = np.random.default_rng(0).integers(0, 1024, (10, 10)).astype("<u2")
    times = [7, 26]
    data = b"".join(
        b"\xff\xff\xff\xff"
        + time.to_bytes(4, "little")
        + raw.tobytes()
        + bytes([(int(raw.sum()) + time) % 256])
        for time in times
    )
    frames = FabricGrid(rows=10, columns=10, crop=1, invert=True).feed(data, 3.5)
    assert [frame.sensor_ms for frame in frames] == times
    np.testing.assert_array_equal(frames[0].pressure, 1023 - raw[1:9, 1:9])
    assert frames[0].pressure.dtype == np.uint16
    assert not frames[0].pressure.flags.writeable
    assert frames[0].host_s == 3.5


def test_a_frame_carries_the_arrival_of_its_last_byte() -> None:
    parser = FabricGrid()
    parser.feed(packets([0, 1]) + packet(2)[:-1], 10.0)
    (frame,) = parser.feed(packet(2)[-1:], 11.0)
    assert (frame.sensor_ms, frame.host_s) == (5000 + 2 * PERIOD_MS, 11.0)


@pytest.mark.parametrize(
    ("damaged", "counted"),
    [
        (flip(packet(2), 0), 1),
        (flip(packet(2), 64), 1),
        (flip(packet(2), 64) + flip(packet(3), 0), 2),
        (b"\xff" * 100, 1),
        (b"\x55" * (3 * SIZE), 3),
        (packet(2)[:6], 1),
        (packet(2)[:-1], 1),
    ],
    ids=["header", "checksum", "two", "ff", "garbage", "cut in clock", "cut in checksum"],
)
def test_damage_is_counted_and_loses_nothing_else(damaged: bytes, counted: int) -> None:
    parser = FabricGrid()
    assert_are(parser.feed(packets([0, 1]) + damaged + packets([4, 5]), 0.0), [0, 1, 4, 5])
    assert (parser.counts.damaged, parser.counts.bad_time) == (counted, 0)


class BadLine:
    """An endless stream of frames with random damage; `intact` lists the undamaged ones.

    A truncated frame is followed by an intact one: garbage in place of its missing bytes would pass the
    one-byte checksum one time in 256.
    """

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self._ms = self._rng.randrange(2**32)
        self._pressures = np.random.default_rng(seed).integers(0, 1024, (64, 8, 8)).astype(np.uint16)
        self.intact: list[int] = []

    def stretch(self) -> bytes:
        """Return some frames of any kind between two intact pairs; sometimes the pad restarts first."""
        if self._rng.random() < 0.1:
            self._ms = self._rng.randrange(2**32)
        pieces = [self._frame(), self._frame()]
        pieces += [self._anything() for _ in range(self._rng.randrange(12))]
        return b"".join([*pieces, self._frame(), self._frame()])

    def _packet(self) -> bytes:
        self._ms = (self._ms + self._rng.randrange(15, 25)) % 2**32
        return encode_fabric_grid(self._rng.choice(self._pressures), self._ms)

    def _frame(self) -> bytes:
        packet = self._packet()
        self.intact.append(self._ms)
        return packet

    def _anything(self) -> bytes:
        rng, whole, intact = self._rng, self._packet, self._frame
        at = rng.choice(INNER_BYTES)
        damages: list[Callable[[], bytes]] = [
            lambda: rng.randbytes(rng.randrange(300)),
            lambda: b"\xff" * rng.randrange(1, 300),
            lambda: whole()[at:],
            lambda: whole()[: rng.randrange(SIZE - 1)] + intact(),
            lambda: flip(whole(), rng.choice(SUMMED_BITS)),
            lambda: flip(whole(), rng.choice(TIME_BITS)) + intact(),
            lambda: (packet := whole())[:at] + packet[at + rng.randrange(1, 9) :] + intact(),
            lambda: (packet := whole())[:at] + rng.randbytes(rng.randrange(1, 9)) + packet[at:],
            lambda: intact() * rng.choice([1, 1, 2]),
        ]
        return rng.choice(damages)()


def assert_survives(chunks: int, seed: int) -> None:
    """Feed at least `chunks` random chunks; check frames, counts and memory."""
    rng = random.Random(seed)
    line, parser = BadLine(seed), FabricGrid()
    fed = 0
    delivered: list[int] = []
    while fed < chunks:
        data = b"".join(line.stretch() for _ in range(20))
        position = 0
        while position < len(data):
            length = rng.choice([1, 2, 7, 64, rng.randrange(1, 500), rng.randrange(1, 5000)])
            delivered += [frame.sensor_ms for frame in parser.feed(data[position : position + length], 0.0)]
            assert len(parser._framing.buffer) < 2 * SIZE
            position += length
            fed += 1
        # The last frame may wait for the next one.
        last = len(delivered)
        assert last >= len(line.intact) - 1
        assert delivered == line.intact[:last]
        del delivered[:-1], line.intact[: last - 1]
    assert parser.counts.bad > 0


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_thousands_of_damaged_chunks_cost_no_intact_frame(seed: int) -> None:
    assert_survives(1500, seed)
