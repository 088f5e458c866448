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
    ("damaged", "counts"),
    [
        (flip(packet(2), 0), {"bad_framing": 1}),
        (flip(packet(2), 40), {"bad_time": 1}),
        (flip(packet(2), 64), {"bad_checksum": 1}),
        (flip(packet(2), 64) + flip(packet(3), 0), {"bad_checksum": 1, "bad_framing": 1}),
        (b"\xff" * 100, {"bad_framing": 1}),
        (b"\x55" * (3 * SIZE), {"bad_framing": 3}),
        (packet(2)[:6], {"bad_checksum": 1}),
        (packet(2)[:-1], {"bad_checksum": 1}),
    ],
    ids=["header", "clock", "checksum", "two", "ff", "garbage", "cut in clock", "cut in checksum"],
)
def test_damage_is_counted_by_kind_and_loses_nothing_else(damaged: bytes, counts: dict[str, int]) -> None:
    parser = FabricGrid()
    assert_are(parser.feed(packets([0, 1]) + damaged + packets([4, 5]), 0.0), [0, 1, 4, 5])
    assert {name: getattr(parser.counts, name) for name in counts} == counts
    assert parser.counts.bad == sum(counts.values())
    assert parser.counts.bytes_dropped == (0 if "bad_time" in counts else len(damaged))


def test_a_false_frame_does_not_hide_a_true_one() -> None:
    """FF FF before a header makes a false frame two bytes early; in 1 of 256 only its clock is wrong."""
    found = 0
    for number in range(2, 2000):
        if FabricGrid().damage_in(b"\xff\xff" + packet(number)[:-2]) is None:
            data = packets([0, 1]) + b"\xff\xff" + packets([number, number + 1])
            parser = FabricGrid()
            assert_are(fed(parser, data, range(0, len(data), 100)), [0, 1, number, number + 1])
            assert parser.counts.bad_time == parser.counts.bad == 1
            found += 1
    assert found > 0


def test_only_an_undetectable_flip_passes() -> None:
    bits = set(range(64, SIZE * 8 - 8)) - set(VISIBLE_VALUE_BITS)
    assert {(bit - 64) % 16 // 8 for bit in bits} == {1}
    for bit in sorted(bits)[::20]:
        parser = FabricGrid()
        assert len(parser.feed(packets([0, 1]) + flip(packet(2), bit) + packet(3), 0.0)) == 4
