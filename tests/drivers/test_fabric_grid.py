"""Binary frames: every intact one arrives once and in order, and no damaged one."""

import numpy as np
import pytest
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.wire import (
    PERIOD_MS,
    SIZE,
    VISIBLE_VALUE_BITS,
    assert_are,
    counts_of,
    fed,
    flip,
    packet,
    packets,
)

# --- what a frame is ---------------------------------------------------------------------------------------


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


def test_the_border_of_a_larger_grid_is_ignored() -> None:
    data = encode_fabric_grid(counts_of(1), 0)
    raw = np.frombuffer(data, "<u2", 100, 8).reshape(10, 10)
    assert len(data) == SIZE
    assert set(raw[0]) | set(raw[-1]) | set(raw[:, 0]) | set(raw[:, -1]) == {1023}


# --- intact frames, however they arrive --------------------------------------------------------------------


def test_a_frame_carries_the_arrival_of_its_last_byte() -> None:
    parser = FabricGrid()
    parser.feed(packets([0, 1]) + packet(2)[:-1], 10.0)
    (frame,) = parser.feed(packet(2)[-1:], 11.0)
    assert (frame.sensor_ms, frame.host_s) == (5000 + 2 * PERIOD_MS, 11.0)


@pytest.mark.parametrize("cut", [1, 3, 4, 7, 8, 9, 100, SIZE - 1])
def test_a_stream_joined_midway_begins_with_the_next_frame(cut: int) -> None:
    assert_are(FabricGrid().feed(packets(range(4))[cut:], 0.0), [1, 2, 3])


# --- damage ------------------------------------------------------------------------------------------------


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
    assert parser.counts.bytes_dropped == len(damaged)


def test_a_flip_in_the_clock_loses_only_its_frame() -> None:
    parser = FabricGrid()
    assert_are(parser.feed(packets([0, 1]) + flip(packet(2), 40) + packets([4, 5]), 0.0), [0, 1, 4, 5])
    assert parser.counts.bad_time == parser.counts.bad == 1


def test_bytes_like_a_header_before_a_frame_do_not_hide_it() -> None:
    for number in range(2, 600):
        data = packets([0, 1]) + b"\xff\xff" + packets([number, number + 1]) + bytes(SIZE)
        parser = FabricGrid()
        assert_are(fed(parser, data, range(0, len(data), 100)), [0, 1, number, number + 1])


def test_only_an_undetectable_flip_passes() -> None:
    bits = set(range(64, SIZE * 8 - 8)) - set(VISIBLE_VALUE_BITS)
    assert {(bit - 64) % 16 // 8 for bit in bits} == {1}
    for bit in sorted(bits)[::20]:
        parser = FabricGrid()
        assert len(parser.feed(packets([0, 1]) + flip(packet(2), bit) + packet(3), 0.0)) == 4
