"""The sensor delivers every intact frame of the pad, says when it cannot, and finds the pad again."""

from __future__ import annotations

import logging
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import serial

from drivers import sensor_state
from drivers.fake_port import FakePort
from drivers.frame import Counts, Frame
from drivers.line_faults import Faults
from drivers.protocol import CsvLines, FabricGrid, Protocol, encode_csv_line, encode_fabric_grid
from drivers.recording import Span, Stream, ideal_clock_ms
from drivers.sensor import FrameQueue, Sensor, SensorError, SensorState, check_port
from drivers.sensor_state import Announcer

BAUD = 512000
Encode = Callable[[Counts, int], bytes]


def stream_of(frames: int = 4000) -> Stream:
    counts = np.random.default_rng(2).integers(0, 1024, (frames, 8, 8)).astype(np.uint16)
    return Stream(counts, ideal_clock_ms(frames, 1000), (Span(0, frames, "rub"),))


@contextmanager
def sensing(port: str, protocol: Protocol | None = None, silence_s: float = 0.3) -> Iterator[FrameQueue]:
    """A running sensor's queue; afterwards nothing of the sensor is left."""
    before = set(os.listdir("/proc/self/fd"))
    queue = FrameQueue(100_000)
    sensor = Sensor(port, BAUD, protocol or FabricGrid(), queue, longest_retry_s=0.2, silence_s=silence_s)
    sensor.start()
    try:
        yield queue
    finally:
        begun_s = time.monotonic()
        sensor.stop()
        sensor.stop()
        assert time.monotonic() - begun_s < 1.0
        assert "touchd-sensor" not in [thread.name for thread in threading.enumerate()]
        assert len(os.listdir("/proc/self/fd")) <= len(before)


def next_frames(queue: FrameQueue, count: int) -> list[Frame]:
    frames: list[Frame] = []
    while len(frames) < count:
        item = queue.get(5.0)
        assert item is not None, f"only {len(frames)} of {count} frames came"
        if isinstance(item, Frame):
            frames.append(item)
    return frames


def next_state(queue: FrameQueue) -> SensorState:
    while not isinstance(item := queue.get(5.0), SensorState):
        assert item is not None, "no state was told"
    return item


def assert_played(frames: list[Frame], stream: Stream, indices: range | list[int]) -> None:
    assert [frame.sensor_ms for frame in frames] == stream.sensor_ms[indices].tolist()
    for frame, index in zip(frames, indices, strict=True):
        np.testing.assert_array_equal(frame.pressure, stream.counts[index])


class Switch:
    """An encoding that can be changed while it plays."""

    def __init__(self, encode: Encode) -> None:
        self.encode = encode

    def __call__(self, counts: Counts, sensor_ms: int) -> bytes:
        return self.encode(counts, sensor_ms)


def silence(counts: Counts, sensor_ms: int) -> bytes:
    return b""


# --- frames ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [None, 20.0])
def test_it_says_up_and_then_delivers_every_frame_in_order(speed: float | None) -> None:
    stream = stream_of(60)
    with FakePort(stream, encode_fabric_grid, speed=speed) as port, sensing(port.path) as queue:
        first = queue.get(5.0)
        assert first == SensorState("up", f"frames arrive from {port.path}")
        frames = next_frames(queue, 60)
    assert_played(frames, stream, range(60))
    assert [frame.number for frame in frames] == list(range(60))


@pytest.mark.parametrize(
    ("faults", "lost"),
    [
        (Faults(chunk_bytes=1), []),
        (Faults(chunk_bytes=50), []),
        (Faults(drop_frame_every=5), [4, 9, 14, 19, 24, 29]),
        (Faults(flip_bit_every=5, garbage_every=3), [4, 9, 14, 19, 24, 29]),
        (Faults(cut_frame_every=10, repeat_frame_every=4), [9, 19, 29]),
    ],
)
def test_on_a_chopped_or_lossy_line_every_intact_frame_is_delivered_once(
    faults: Faults, lost: list[int]
) -> None:
    stream = stream_of(32)
    intact = [index for index in range(32) if index not in lost]
    with FakePort(stream, encode_fabric_grid, speed=20.0, faults=faults) as port, sensing(port.path) as queue:
        assert_played(next_frames(queue, len(intact)), stream, intact)


def test_a_pad_that_prints_lines_is_read_too() -> None:
    stream = stream_of(20)
    with FakePort(stream, encode_csv_line, speed=20.0) as port, sensing(port.path, CsvLines()) as queue:
        assert_played(next_frames(queue, 19), stream, range(1, 20))


def test_a_frame_bears_the_time_its_last_byte_arrived() -> None:
    stream = stream_of(40)
    with FakePort(stream, encode_fabric_grid, speed=2.0) as port, sensing(port.path) as queue:
        frames = next_frames(queue, 40)
    delay_s = np.array([frame.host_s for frame in frames]) - port.sent_s
    assert delay_s.min() > 0.0
    assert np.median(delay_s) < 0.01


def test_frames_that_come_in_a_burst_after_a_stall_keep_their_true_arrival() -> None:
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
    assert frames[20].host_s - frames[10].host_s < 0.15


def test_any_address_pyserial_knows_will_do() -> None:
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
    # What is sent while the port is being opened is discarded, as on a cable.
    first = stream.sensor_ms.tolist().index(frames[0].sensor_ms)
    assert_played(frames, stream, range(first, first + 10))


# --- up and down -------------------------------------------------------------------------------------------


def test_a_pad_that_falls_silent_is_down_and_up_again_when_it_goes_on() -> None:
    switch = Switch(encode_fabric_grid)
    with FakePort(stream_of(), switch) as port, sensing(port.path) as queue:
        next_frames(queue, 5)
        switch.encode = silence
        assert next_state(queue) == SensorState("down", f"{port.path} at 512000 baud: no data for 0.3 s")
        switch.encode = encode_fabric_grid
        assert next_state(queue).reason.startswith(f"frames arrive from {port.path} again after 0.")
        next_frames(queue, 5)


def noise(counts: Counts, sensor_ms: int) -> bytes:
    return np.random.default_rng(sensor_ms).bytes(200)


def half_frames(counts: Counts, sensor_ms: int) -> bytes:
    return encode_fabric_grid(counts, sensor_ms)[: 20 + sensor_ms % 150]


def as_8x8(counts: Counts, sensor_ms: int) -> bytes:
    return encode_fabric_grid(counts, sensor_ms, rows=8, columns=8, crop=0)


def clock_stands(counts: Counts, sensor_ms: int) -> bytes:
    return encode_fabric_grid(counts, 77)


@pytest.mark.parametrize(
    ("trouble", "reason"),
    [
        (noise, "noise, wrong baud rate?"),
        (half_frames, "frames begin but none of fabric-grid 10x10 is whole"),
        (as_8x8, "looks like fabric-grid 8x8, configured fabric-grid 10x10"),
        (encode_csv_line, "looks like lines of 101 numbers, configured fabric-grid 10x10"),
        (clock_stands, "frames of fabric-grid 10x10 arrive, but their clock stands still or jumps"),
    ],
)
def test_bytes_without_frames_are_recognised_and_frames_come_again_when_they_are_right(
    trouble: Encode, reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    switch = Switch(trouble)
    with FakePort(stream_of(), switch) as port, sensing(port.path) as queue:
        assert reason in next_state(queue).reason
        time.sleep(0.4)
        switch.encode = encode_fabric_grid
        begun_s = time.monotonic()
        assert next_state(queue).state == "up"
        next_frames(queue, 5)
        assert time.monotonic() - begun_s < 2.0
    assert [record.levelname for record in caplog.records] == ["WARNING", "INFO"]


def test_a_10x10_pad_is_recognised_where_8x8_or_lines_were_configured() -> None:
    with FakePort(stream_of(), encode_fabric_grid) as port:
        with sensing(port.path, FabricGrid(8, 8, 0)) as queue:
            assert "looks like fabric-grid 10x10, configured fabric-grid 8x8" in next_state(queue).reason
        with sensing(port.path, CsvLines()) as queue:
            assert "looks like fabric-grid 10x10, configured csv 10x10" in next_state(queue).reason


def test_a_pad_unplugged_and_back_under_another_name_is_found_again_by_its_link(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    link = tmp_path / "touchd-pad"
    first, second = (FakePort(stream_of(), encode_fabric_grid) for _ in range(2))
    link.symlink_to(first.path)
    with sensing(str(link)) as queue:
        first.start()
        next_frames(queue, 5)
        first.stop()
        link.unlink()
        assert "touchd-pad" in next_state(queue).reason
        time.sleep(0.5)
        link.symlink_to(second.path)
        second.start()
        begun_s = time.monotonic()
        assert "again after" in next_state(queue).reason
        frames = next_frames(queue, 5)
        assert time.monotonic() - begun_s < 2.0
    second.stop()
    assert frames[-1].number > 5
    assert [record.levelname for record in caplog.records] == ["INFO", "WARNING", "INFO"]


def test_a_pad_plugged_in_late_is_waited_for(tmp_path: Path) -> None:
    link = tmp_path / "touchd-pad"
    with sensing(str(link)) as queue:
        assert next_state(queue) == SensorState(
            "down", f"{link} is not there: is the pad plugged in and switched on?"
        )
        with FakePort(stream_of(), encode_fabric_grid) as port:
            link.symlink_to(port.path)
            assert next_state(queue).state == "up"


def test_a_loose_plug_is_warned_of_once(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    caplog.set_level(logging.INFO)
    link = tmp_path / "touchd-pad"
    with sensing(str(link)) as queue:
        for _ in range(4):
            with FakePort(stream_of(), encode_fabric_grid) as port:
                link.unlink(missing_ok=True)
                link.symlink_to(port.path)
                while next_state(queue).state != "up":
                    pass
            assert next_state(queue).state == "down"
    assert [record.levelname for record in caplog.records] == ["WARNING", "INFO"]


def test_a_pad_that_goes_for_good_soon_after_it_came_back_is_warned_of(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    states: list[SensorState] = []
    announcer = Announcer(states.append)
    announcer.down("missing", "gone")
    announcer.up("pad")
    announcer.down("missing", "gone again")
    announcer.down("missing", "still gone")
    assert [record.message for record in caplog.records] == ["gone"]
    monkeypatch.setattr(sensor_state, "STEADY_S", 0.0)
    announcer.down("missing", "gone for good")
    announcer.down("missing", "gone for good")
    assert [record.message for record in caplog.records] == ["gone", "gone for good"]
    assert [state.state for state in states] == ["down", "up", "down", "down"]


def test_a_busy_port_is_named_and_taken_when_it_is_free() -> None:
    with FakePort(stream_of(), encode_fabric_grid) as port:
        other = serial.Serial(port.path, exclusive=True)
        with sensing(port.path) as queue:
            assert "busy: another program reads it" in next_state(queue).reason
            other.close()
            assert next_state(queue).state == "up"
            next_frames(queue, 2)


def test_a_failure_nobody_foresaw_is_told_and_gone_when_its_cause_is() -> None:
    class Fragile(FabricGrid):
        broken = True

        def feed(self, data: bytes, host_s: float) -> list[Frame]:
            if self.broken:
                raise ZeroDivisionError("unforeseen")
            return super().feed(data, host_s)

    protocol = Fragile()
    with FakePort(stream_of(), encode_fabric_grid) as port, sensing(port.path, protocol) as queue:
        assert "internal error" in next_state(queue).reason
        protocol.broken = False
        assert next_state(queue).state == "up"


def test_it_stops_at_once_while_nothing_is_there_and_before_it_began(tmp_path: Path) -> None:
    with sensing(str(tmp_path / "none")) as queue:
        next_state(queue)
    Sensor("/dev/none", BAUD, FabricGrid(), FrameQueue()).stop()


def test_it_stops_at_once_while_frames_pour_in() -> None:
    with (
        FakePort(stream_of(), encode_fabric_grid, speed=None, loop=True) as port,
        sensing(port.path) as queue,
    ):
        next_frames(queue, 100)


# --- the port, before anything starts ----------------------------------------------------------------------


def test_a_port_that_can_be_read_passes_and_is_not_disturbed() -> None:
    with FakePort(stream_of(5), encode_fabric_grid, speed=None) as port:
        check_port(port.path, BAUD)
        assert not port.wait(0.05)
        assert np.isnan(port.sent_s).all()


@pytest.mark.parametrize(
    ("port", "baud", "message"),
    [
        ("/dev/touchd-none", BAUD, "/dev/touchd-none is not there: is the pad plugged in"),
        ("", BAUD, "is not there"),
        (__file__, BAUD, "test_sensor.py is no serial port: name a device like /dev/ttyACM0"),
        ("/", BAUD, "/ is no serial port"),
        ("scoket://pad:1", BAUD, "scoket://pad:1 cannot be opened: .*'scoket' not known"),
        ("/dev/null", -1, "/dev/null cannot be opened: .*baudrate"),
    ],
)
def test_a_port_that_cannot_work_is_refused_in_one_line(port: str, baud: int, message: str) -> None:
    with pytest.raises(SensorError, match=message) as refusal:
        check_port(port, baud)
    assert "\n" not in str(refusal.value)


def test_a_device_that_is_no_terminal_is_said_to_be_none() -> None:
    with sensing("/dev/null") as queue:
        assert "/dev/null cannot be opened" in next_state(queue).reason


def test_without_permission_it_says_how_to_get_it() -> None:
    with FakePort(stream_of(5), encode_fabric_grid) as port:
        os.chmod(port.path, 0)
        is_root = os.geteuid() == 0
        try:
            if is_root:
                os.seteuid(65534)
            with pytest.raises(SensorError, match=r"no permission.*group dialout.*udev rule"):
                check_port(port.path, BAUD)
            with sensing(port.path) as queue:
                assert "no permission" in next_state(queue).reason
        finally:
            if is_root:
                os.seteuid(0)


# --- the queue ---------------------------------------------------------------------------------------------


def frame(number: int) -> Frame:
    return Frame(number, number * 19, 0.0, np.zeros((8, 8), np.uint16))


def test_a_full_queue_gives_up_its_oldest_frames_counts_them_and_keeps_states() -> None:
    queue = FrameQueue(4)
    down, up = SensorState("down", "unplugged"), SensorState("up", "back")
    for item in (down, frame(0), up, frame(1), frame(2), frame(3)):
        queue.put(item)
    assert len(queue) == 4
    assert queue.dropped == 2
    assert [queue.get(0.0), queue.get(0.0)] == [down, up]
    assert [item.number for item in (queue.get(0.0), queue.get(0.0)) if isinstance(item, Frame)] == [2, 3]
    assert queue.get(0.01) is None


def test_a_queue_of_nothing_but_states_is_bounded_too() -> None:
    queue = FrameQueue(3)
    for number in range(10):
        queue.put(SensorState("down", str(number)))
    assert len(queue) == 3
    assert queue.get(0.0) == SensorState("down", "7")


def test_a_waiting_reader_is_woken_by_the_next_item() -> None:
    queue = FrameQueue()
    threading.Timer(0.05, queue.put, [frame(7)]).start()
    item = queue.get(5.0)
    assert isinstance(item, Frame)
    assert item.number == 7
