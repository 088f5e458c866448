"""The sensor delivers every intact frame at once, and stops at once."""

import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.formats import FabricGrid, encode_csv_line, encode_fabric_grid
from rigs.line_faults import NO_FAULTS, Faults, FaultyPort
from rigs.sensor_rig import BAUD, Encode, assert_played, next_frames, next_state, sensing, stream_of
from rigs.wait import WITHIN_S, once_in_three

from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Counts, Frame, SensorState
from touchd.drivers.pad.format import PRESETS, PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.sensor import FrameQueue, Sensor


@pytest.mark.parametrize(
    ("faults", "lost"),
    [
        (NO_FAULTS, []),
        (Faults(chunk_bytes=1), []),
        (Faults(chunk_bytes=50), []),
        (Faults(drop_frame_every=5), [4, 9, 14, 19, 24, 29]),
        (Faults(flip_bit_every=5, garbage_every=3), [4, 9, 14, 19, 24, 29]),
        (Faults(cut_frame_every=10, repeat_frame_every=4), [9, 19, 29]),
    ],
)
def test_up_comes_first_then_every_intact_frame_once(faults: Faults, lost: list[int]) -> None:
    stream = stream_of(32)
    intact = [index for index in range(32) if index not in lost]
    with (
        FaultyPort(stream, encode_fabric_grid, speed=20.0, faults=faults) as port,
        sensing(port.path) as queue,
    ):
        assert queue.get(WITHIN_S) == SensorState("up", f"frames arrive from {port.path}")
        frames = next_frames(queue, len(intact))
    assert_played(frames, stream, intact)


def without_clock(counts: Counts, sensor_ms: int) -> bytes:
    return encode_csv_line(counts, sensor_ms).partition(b",")[2]


def delays_s(frames: list[Frame], port: FakePort) -> NDArray[np.float64]:
    """Return how long after a frame's last byte was sent it arrived."""
    return np.array([frame.host_s for frame in frames]) - port.sent_s[-len(frames) :]


@once_in_three
def test_frames_after_a_stall_keep_their_true_arrival() -> None:
    stream = stream_of(30)
    stall_s, stalled_s = 0.4, 0.0

    def stall_once(counts: Counts, sensor_ms: int) -> bytes:
        nonlocal stalled_s
        if sensor_ms == stream.sensor_ms[10]:
            time.sleep(stall_s)
            stalled_s = time.monotonic()
        return encode_fabric_grid(counts, sensor_ms)

    with FakePort(stream, stall_once) as port, sensing(port.path, silence_s=1.0) as queue:
        frames = next_frames(queue, 30)
    assert_played(frames, stream, range(30))
    assert frames[9].host_s < stalled_s <= frames[10].host_s
    assert np.median(delays_s(frames[10:], port)) < 0.01


WITHOUT_CLOCK = PadFormat(framing="text", rows=10, columns=10, crop=1)


@pytest.mark.parametrize(
    ("encode", "parser", "together", "read"),
    [
        (encode_fabric_grid, FabricGrid(), 3, 3),
        (encode_csv_line, FrameParser(PRESETS["csv"]), 3, 3),
        (encode_fabric_grid, FabricGrid(), 1, 1),
        (without_clock, FrameParser(WITHOUT_CLOCK), 3, 1),
    ],
    ids=["quiet", "quiet, text", "touched", "quiet, without a clock"],
)
def test_a_quiet_pad_with_a_clock_is_read_three_frames_at_once(
    encode: Encode, parser: FrameParser, together: int, read: int
) -> None:
    queue = FrameQueue()

    def is_as_wanted() -> bool:
        frames = next_frames(queue, 50)
        return 0.7 * read < len(frames) / len({frame.host_s for frame in frames}) < 1.7 * read

    with FakePort(stream_of(200), encode, loop=True) as port:
        sensor = Sensor(port.path, BAUD, parser, queue)
        sensor.frames_together = together
        sensor.start()
        # A busy machine delays some reads, which then bring more frames; shorter ones follow.
        assert any(is_as_wanted() for _ in range(5))
        sensor.stop()
    assert parser.counts.bad == queue.dropped == 0


@once_in_three
def test_a_fast_pads_frames_do_not_fill_its_port_meanwhile() -> None:
    queue = FrameQueue()
    with FakePort(stream_of(1000), encode_fabric_grid, speed=9.0) as port:
        sensor = Sensor(port.path, BAUD, FabricGrid(), queue)
        sensor.frames_together = 3
        sensor.start()
        arrivals_s = [frame.host_s for frame in next_frames(queue, 1000)[800:]]
        sensor.stop()
    # Linux keeps 4096 bytes, which are 19 frames. A busy machine delays some of the reads.
    assert np.quantile(list(Counter(arrivals_s).values()), 0.9) < 15


def test_a_full_queue_drops_old_frames_but_no_state() -> None:
    queue = FrameQueue(4)
    down, up = SensorState("down", "unplugged"), SensorState("up", "back")
    frames = [Frame(number * 19, 0.0, np.zeros((8, 8), np.uint16)) for number in range(4)]
    for item in (down, frames[0], up, *frames[1:]):
        queue.put(item)
    assert (len(queue), queue.dropped) == (4, 2)
    assert queue.take_all() == [down, up, frames[2], frames[3]]
    assert queue.get(0.01) is None
    for state in [down, down, up] * 4:
        queue.put(state)
    assert queue.take_all() == [up, down, down, up]


def test_it_stops_at_once_before_and_while_waiting(tmp_path: Path) -> None:
    with sensing(str(tmp_path / "none")) as queue:
        next_state(queue)
    Sensor("/dev/none", BAUD, FabricGrid(), FrameQueue()).stop()


def test_it_stops_at_once_under_a_flood_of_frames() -> None:
    with (
        FakePort(stream_of(), encode_fabric_grid, speed=None, loop=True) as port,
        sensing(port.path) as queue,
    ):
        next_frames(queue, 100)
