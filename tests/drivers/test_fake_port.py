"""The fake port behaves on its pty as a pad on its cable: pace, bytes, disconnection."""

import pty
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import serial
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.sensor_rig import BAUD, stream_of
from rigs.wait import AT_ONCE_S, wait_for
from rigs.wire import SIZE

from touchd.drivers.errors import TouchdError
from touchd.drivers.fakes.fake_port import FakePort, LivePort
from touchd.drivers.recording import Stream

FLAT_OUT = 1e6


def encoded(stream: Stream) -> bytes:
    return b"".join(map(encode_fabric_grid, stream.counts, stream.sensor_ms.tolist()))


def opened(port: FakePort) -> serial.Serial:
    return serial.Serial(port.path, BAUD, timeout=2.0)


def read_to_end(port: FakePort, reader: serial.Serial) -> bytes:
    reader.timeout, data = 0.1, b""
    # The kernel may still buffer the last bytes after the port has sent them.
    while (more := reader.read(max(1, reader.in_waiting))) or not port.wait(0.0):
        data += more
    return data


def descriptors() -> set[str]:
    links = (link for link in Path("/proc/self/fd").iterdir() if link.is_symlink())
    return {f"{link.name}:{link.readlink()}" for link in links}


@pytest.fixture(autouse=True)
def nothing_is_left() -> Iterator[None]:
    before = descriptors()
    yield
    assert [thread.name for thread in threading.enumerate() if thread.name == "touchd-fake-port"] == []
    assert {fd for fd in descriptors() - before if "pts" in fd or "ptmx" in fd} == set()


def test_flat_out_a_slow_reader_gets_every_byte_in_order() -> None:
    stream = stream_of(600)
    with FakePort(stream, encode_fabric_grid, speed=FLAT_OUT) as port, opened(port) as reader:
        assert not port.wait(0.1)
        data = reader.read(50 * SIZE)
        assert not port.wait(0.05)
        data += read_to_end(port, reader)
    assert data == encoded(stream)


def test_the_recordings_pace_is_kept_without_drift() -> None:
    stream = stream_of(40)
    with FakePort(stream, encode_fabric_grid, speed=2.0) as port, opened(port) as reader:
        read_to_end(port, reader)
    due_s = (stream.sensor_ms - 1000) / 1000 / 2.0
    late_s = port.sent_s - due_s
    # A busy machine may be late with any frame, but is early with none.
    assert np.median(late_s) - late_s.min() < 0.05
    assert abs(np.median(late_s[20:]) - np.median(late_s[:20])) < 0.05


def test_a_looped_stream_continues_with_its_clock() -> None:
    stream = stream_of(5)
    parser = FabricGrid()
    with FakePort(stream, encode_fabric_grid, speed=FLAT_OUT, loop=True) as port, opened(port) as reader:
        frames = parser.feed(reader.read(12 * SIZE), 0.0)
        assert not port.wait(0.0)
    assert len(frames) == 12
    assert set(np.diff([frame.sensor_ms for frame in frames])) <= {18, 19}
    np.testing.assert_array_equal(frames[5].pressure, frames[0].pressure)


def test_when_it_stops_the_reader_sees_the_device_go() -> None:
    port = FakePort(stream_of(5), encode_fabric_grid)
    port.start()
    with opened(port) as reader:
        assert reader.read(1) == b"\xff"
        port.stop()
        with pytest.raises(serial.SerialException):
            reader.read(10**6)
    assert not Path(port.path).exists()


def test_it_stops_at_once_in_every_state_and_leaves_nothing() -> None:
    unread, not_started = (FakePort(stream_of(5), encode_fabric_grid) for _ in range(2))
    blocked = FakePort(stream_of(600), encode_fabric_grid, speed=FLAT_OUT)
    playing = FakePort(stream_of(600), encode_fabric_grid)
    for port in (unread, blocked, playing):
        port.start()
    with opened(blocked), opened(playing) as reader:
        reader.read(1)
        wait_for(lambda: bool(np.isfinite(blocked.sent_s).sum() > 50))
        begun_s = time.monotonic()
        for port in (unread, not_started, blocked, playing):
            assert Path(port.path).exists()
            port.stop()
            port.stop()
            assert not Path(port.path).exists()
        assert time.monotonic() - begun_s < AT_ONCE_S


def test_a_system_without_pseudo_terminals_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> tuple[int, int]:
        raise OSError("out of pty devices")

    monkeypatch.setattr(pty, "openpty", refuse)
    with pytest.raises(TouchdError, match=r"no pseudo-terminal .*out of pty devices.*/dev/pts"):
        LivePort(lambda _: np.zeros((8, 8), np.uint16), encode_fabric_grid)
