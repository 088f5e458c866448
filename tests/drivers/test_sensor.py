"""The sensor delivers every intact frame at once, and stops at once."""

import socket
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.line_faults import NO_FAULTS, Faults, FaultyPort
from rigs.sensor_rig import BAUD, assert_played, next_frames, next_state, sensing, stream_of
from rigs.wait import WITHIN_S

from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Counts, Frame
from touchd.drivers.pad.format import PRESETS, encode_frame
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.pad.sensor import MOVED_S, FrameQueue, Sensor, SensorState, check_port
from touchd.drivers.queue import Signal
from touchd.drivers.recording import Stream, ideal_clock_ms


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
    assert [frame.number for frame in frames] == list(range(len(intact)))


def delays_s(frames: list[Frame], port: FakePort) -> NDArray[np.float64]:
    """Return how long after a frame's last byte was sent it arrived."""
    return np.array([frame.host_s for frame in frames]) - port.sent_s[-len(frames) :]


def test_a_frames_time_is_the_arrival_of_its_last_byte() -> None:
    with FakePort(stream_of(40), encode_fabric_grid, speed=2.0) as port, sensing(port.path) as queue:
        frames = next_frames(queue, 40)
    assert delays_s(frames, port).min() > 0.0
    assert np.median(delays_s(frames, port)) < 0.01


def test_frames_that_may_wait_arrive_together_and_complete() -> None:
    stream, came = stream_of(40), []
    with FakePort(stream, encode_fabric_grid) as port, sensing(port.path, may_wait=True) as queue:
        while not port.wait(0.001):
            came.append(len(queue))
        frames = next_frames(queue, 40)
    assert_played(frames, stream, range(40))
    assert np.median(delays_s(frames, port)) < 0.1
    assert len(set(came)) <= 40 / 2


def playing(counts: Counts) -> FakePort:
    """A port that sends these counts."""
    return FakePort(Stream(counts, ideal_clock_ms(len(counts)), ()), encode_fabric_grid)


def test_a_pad_that_keeps_still_wakes_nobody_until_it_is_touched() -> None:
    still, touched = 40, 10
    counts = np.random.default_rng(0).integers(20, 24, (still + touched, 8, 8)).astype(np.uint16)
    counts[still:, 3, 4] += 30
    arrived = Signal()
    with playing(counts) as port, sensing(port.path, filled=arrived, loop_may_sleep=True) as queue:
        assert arrived.wait(WITHIN_S)
        assert isinstance(queue.get_nowait(), SensorState)
        assert arrived.wait(WITHIN_S)
        assert still < len(queue) < still + touched
        # One frame shows no touch yet, so those after it come at once too, though nothing moves any more.
        queue.take_all()
        assert all(arrived.wait(MOVED_S / 2) for _ in range(3))


@pytest.mark.parametrize(("counts_a_frame", "is_felt"), [(1.0, True), (0.2, False)], ids=["hand", "drift"])
def test_a_slow_hand_wakes_the_loop_and_a_drift_does_not(counts_a_frame: float, is_felt: bool) -> None:
    scans = np.zeros((80, 8, 8), np.uint16)
    scans[:, 3, 4] = np.arange(80) * counts_a_frame
    arrived = Signal()
    with playing(scans) as port, sensing(port.path, filled=arrived, loop_may_sleep=True) as queue:
        # The first state and the first frame.
        next_frames(queue, 1)
        while arrived.wait(0.0):
            pass
        assert port.wait(WITHIN_S)
        assert arrived.wait(0.0) == is_felt


def test_frames_stamped_on_arrival_never_wait() -> None:
    described = PRESETS["velostat"]
    with (
        FakePort(stream_of(40), lambda counts, _: encode_frame(described, counts, None)) as port,
        sensing(port.path, parser_of(described), may_wait=True) as queue,
    ):
        assert port.wait(WITHIN_S)
        frames = [item for item in queue.take_all() if isinstance(item, Frame)]
    assert np.median(delays_s(frames, port)) < 0.01


def test_frames_after_a_stall_keep_their_true_arrival() -> None:
    stream = stream_of(30)
    stalled_s = 0.0

    def stall_once(counts: Counts, sensor_ms: int) -> bytes:
        nonlocal stalled_s
        if sensor_ms == stream.sensor_ms[10]:
            time.sleep(0.4)
            stalled_s = time.monotonic()
        return encode_fabric_grid(counts, sensor_ms)

    with FakePort(stream, stall_once) as port, sensing(port.path, silence_s=1.0) as queue:
        frames = next_frames(queue, 30)
    assert_played(frames, stream, range(30))
    assert frames[9].host_s < stalled_s <= frames[10].host_s
    assert np.median(delays_s(frames[10:], port)) < 0.01


def test_any_pyserial_address_works() -> None:
    stream = stream_of(60)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"socket://127.0.0.1:{server.getsockname()[1]}"
        check_port(address, BAUD)
        with sensing(address) as queue:
            connection, _ = server.accept()
            with connection:
                for counts, ms in zip(stream.counts, stream.sensor_ms.tolist(), strict=True):
                    connection.sendall(encode_fabric_grid(counts, ms))
                    time.sleep(0.002)
                frames = next_frames(queue, 10)
    # Bytes sent while the port is being opened are discarded, as on a cable.
    first = stream.sensor_ms.tolist().index(frames[0].sensor_ms)
    assert_played(frames, stream, range(first, first + 10))


def test_a_full_queue_drops_old_frames_but_no_state() -> None:
    queue = FrameQueue(4)
    down, up = SensorState("down", "unplugged"), SensorState("up", "back")
    frames = [Frame(number, number * 19, 0.0, np.zeros((8, 8), np.uint16)) for number in range(4)]
    for item in (down, frames[0], up, *frames[1:]):
        queue.put(item)
    assert (len(queue), queue.dropped) == (4, 2)
    assert queue.take_all() == [down, up, frames[2], frames[3]]
    assert queue.get(0.01) is None


def test_a_queue_of_nothing_but_states_is_bounded_too() -> None:
    queue = FrameQueue(3)
    for number in range(10):
        queue.put(SensorState("down", str(number)))
    assert len(queue) == 3
    assert queue.get(0.0) == SensorState("down", "7")


def test_it_stops_at_once_before_and_while_waiting(tmp_path: Path) -> None:
    with sensing(str(tmp_path / "none")) as queue:
        next_state(queue)
    Sensor("/dev/none", BAUD, FabricGrid(), FrameQueue()).stop()


def test_it_stops_at_once_while_frames_pour_in() -> None:
    with (
        FakePort(stream_of(), encode_fabric_grid, speed=None, loop=True) as port,
        sensing(port.path) as queue,
    ):
        next_frames(queue, 100)
