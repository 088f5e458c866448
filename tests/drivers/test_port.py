"""Ports and pads on a network: each fault is reported in one line, and frames come again after it."""

import errno
import fcntl
import logging
import os
import re
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
import serial
from rigs.formats import CsvLines, FabricGrid, encode_csv_line, encode_fabric_grid
from rigs.sensor_rig import BAUD, assert_played, next_frames, next_state, sensing, stream_of
from rigs.sockets import free_port

from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Frame
from touchd.drivers.pad import port as pad_port
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import SensorError, check_port, open_port, read_waiting, sensor_error
from touchd.drivers.pad.sensor import FrameQueue, Sensor

# See ioctl_tty(2); the module termios lacks it.
TIOCGEXCL = 0x80045440


def test_a_readable_port_passes_undisturbed() -> None:
    with FakePort(stream_of(5), encode_fabric_grid, speed=1e6) as port:
        check_port(port.path, BAUD)
        assert not port.wait(0.05)
        assert np.isnan(port.sent_s).all()


@pytest.mark.parametrize(
    ("port", "baud", "message"),
    [
        ("/dev/touchd-none", BAUD, "/dev/touchd-none is not there"),
        ("", BAUD, "is not there"),
        ("ttyACM9", BAUD, "ttyACM9 is not there"),
        ("/etc/passwd", BAUD, "/etc/passwd is not a serial port: name a device like /dev/ttyACM0"),
        ("/", BAUD, "/ is not a serial port"),
        ("socket://pad:1", BAUD, "socket://pad:1 cannot be opened: not an address such as tcp://"),
        ("tcp://pad:port", BAUD, "tcp://pad:port cannot be opened: not an address such as tcp://"),
        ("udp://pad:65536", BAUD, "not an address such as"),
        ("tcp://", BAUD, "not an address such as"),
        ("tcp://pad:4000?a", BAUD, "not an address such as"),
        ("tcp://pad", BAUD, "lacks its port; write it as in tcp://pad:4000"),
        ("tcp://pad:", BAUD, "lacks its port; write it as in tcp://pad:4000"),
        ("/dev/null", -1, "/dev/null cannot be opened: .*baudrate"),
    ],
)
def test_a_port_that_cannot_work_is_refused_in_one_line(port: str, baud: int, message: str) -> None:
    with pytest.raises(SensorError, match=message) as refusal:
        check_port(port, baud)
    assert "\n" not in str(refusal.value)


def test_a_missing_port_is_reported_with_the_existing_ones(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(pad_port, "DEV", tmp_path)
    for name in ("ttyUSB0", "ttyACM1", "ttyS0"):
        (tmp_path / name).touch()
    with pytest.raises(SensorError, match=rf"is not there; there is {tmp_path}/ttyACM1, {tmp_path}/ttyUSB0$"):
        open_port(f"{tmp_path}/ttyACM5", BAUD)
    with pytest.raises(SensorError, match=r"cannot be opened: [^;]*$"):
        open_port("/dev/null", BAUD)
    with pytest.raises(SensorError, match=r"refuses the connection$"):
        open_port(f"tcp://127.0.0.1:{free_port()}", BAUD)


@pytest.mark.parametrize(
    ("number", "kind", "reason"),
    [
        (errno.ENXIO, "missing", "/dev/ttyACM0 has no device any more"),
        (errno.EIO, "missing", "went away: unplugged or switched off?"),
        (errno.EPERM, "denied", "may not be opened by this user"),
        (errno.EBUSY, "busy", "is open in another program"),
        (errno.EAGAIN, "busy", "is open in another program"),
        (errno.EADDRNOTAVAIL, "unusable", "is not an address of this computer, where touchd listens"),
        (errno.EINVAL, "unusable", "cannot be opened: Invalid argument"),
    ],
)
def test_system_errors_of_a_port_are_reported_in_words(
    number: int, kind: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(SensorError, match=re.escape(reason)) as refused:
        open_port("/dev/ttyACM0", BAUD)
    assert (refused.value.kind, refused.value.number) == (kind, number)


def test_an_address_that_does_not_answer_is_missing() -> None:
    assert sensor_error("tcp://pad:4000", OSError(errno.EHOSTDOWN, "Host is down")).kind == "missing"


def test_missing_permission_is_reported_until_it_is_granted(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with FakePort(stream_of(), encode_fabric_grid) as port:
        os.chmod(port.path, 0)
        is_root = os.geteuid() == 0
        if is_root:
            os.seteuid(65534)
        try:
            with sensing(port.path) as queue:
                assert "may not be opened by this user; touchd doctor says more" in next_state(queue).reason
                if is_root:
                    os.seteuid(0)
                else:
                    os.chmod(port.path, 0o600)
                begun_s = time.monotonic()
                assert next_state(queue).state == "up"
                assert time.monotonic() - begun_s < 10.0
            assert [record.levelname for record in caplog.records] == ["WARNING", "INFO"]
        finally:
            if is_root:
                os.seteuid(0)


def test_a_device_is_opened_for_this_program_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)

    def is_exclusive() -> bool:
        return bool(struct.unpack("i", fcntl.ioctl(slave, TIOCGEXCL, bytes(4)))[0])

    try:
        # A pseudo-terminal would stay closed to others after touchd was killed.
        with open_port(path, BAUD):
            assert not is_exclusive()
            with pytest.raises(SensorError, match="is open in another program"):
                open_port(path, BAUD)
        # Root may open an exclusive device all the same, so ask the kernel.
        monkeypatch.setattr(os.path, "realpath", lambda port: "/dev/ttyACM0" if port == path else port)
        with open_port(path, BAUD):
            assert is_exclusive()
    finally:
        os.close(master)
        os.close(slave)


STREAM = stream_of(400)
PACKETS = list(map(encode_fabric_grid, STREAM.counts, STREAM.sensor_ms.tolist()))


def send(give: Callable[[bytes], object], numbers: range) -> None:
    for number in numbers:
        give(PACKETS[number])
        time.sleep(0.001)


def test_a_lost_tcp_pad_is_found_again() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        check_port(address, 9600)
        with sensing(address) as queue:
            for first in (0, 50):
                connection, _ = server.accept()
                with connection:
                    send(connection.sendall, range(first, first + 50))
                    assert next_state(queue).state == "up"
                    assert_played(next_frames(queue, 50), STREAM, range(first, first + 50))
                down = next_state(queue)
                assert down.state == "down"
                assert down.reason.startswith(f"{address} closed the connection; touchd doctor says more")


def test_no_frame_spans_a_reconnect() -> None:
    lines = list(map(encode_csv_line, STREAM.counts[:40], STREAM.sensor_ms.tolist()))
    begun, rest = lines[20].rsplit(b",", 50)[0], lines[21].split(b",", 51)[-1]
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with sensing(address, CsvLines()) as queue:
            for sent in (b"".join(lines[:20]) + begun, b"," + rest + b"".join(lines[22:])):
                with server.accept()[0] as connection:
                    connection.sendall(sent)
            assert_played(next_frames(queue, 37), STREAM, [*range(1, 20), *range(22, 40)])


@contextmanager
def udp_pad() -> Iterator[tuple[str, Callable[[bytes], object]]]:
    """Yield an address to listen at, and a function that sends a datagram there from a new socket."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        where = probe.getsockname()

    def give(data: bytes) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(data, where)

    yield f"udp://127.0.0.1:{where[1]}", give


def test_a_lost_datagram_loses_only_its_frame() -> None:
    parser = FabricGrid()
    with udp_pad() as (address, give), open_port(address, 9600) as opened:
        kept = [number for number in range(60) if number % 7 != 2]
        frames = []
        for number in range(60):
            half = len(PACKETS[number]) // 2
            # The second of a frame's two datagrams is lost.
            give(PACKETS[number] if number in kept else PACKETS[number][:half])
            frames += parser.feed(read_waiting(opened, parser), time.monotonic())
    assert_played(frames, STREAM, kept)
    assert parser.counts.bad == 60 - len(kept)


def test_a_quiet_udp_pad_is_read_at_its_rate() -> None:
    queue = FrameQueue()
    with udp_pad() as (address, give):
        sensor = Sensor(address, 0, FabricGrid(), queue)
        sensor.frames_together = 3
        sensor.start()
        for packet in PACKETS[:80]:
            give(packet)
            time.sleep(0.005)
        sent_s = time.monotonic()
        while (frame := next_frames(queue, 1)[0]).sensor_ms != STREAM.sensor_ms[79]:
            pass
        sensor.stop()
    # At a datagram for each rest of three frames, the last ones would come four seconds late.
    assert frame.host_s - sent_s < 2.0


def test_resetting_the_input_drops_all_earlier_datagrams() -> None:
    with udp_pad() as (address, give), open_port(address, 9600) as opened:
        for packet in PACKETS[:3]:
            give(packet)
        opened.reset_input_buffer()
        give(PACKETS[3])
        assert read_waiting(opened, FabricGrid()) == PACKETS[3]


@pytest.mark.parametrize("stray", [b"", b"hello", PACKETS[0][:50]], ids=["empty", "text", "half a frame"])
def test_stray_datagrams_cost_a_udp_pad_no_frame(stray: bytes) -> None:
    with udp_pad() as (address, give), sensing(address, silence_s=1.0) as queue:
        for number in range(60):
            give(stray)
            give(PACKETS[number])
            time.sleep(0.005)
        items = queue.take_all()
    assert [item.state for item in items if not isinstance(item, Frame)] == ["up"]
    assert len(items) > 30


@pytest.mark.parametrize("line_end", ["", "\n", "\r\n"])
@pytest.mark.parametrize("lines", [1, 8], ids=["a line", "a line a row"])
def test_a_datagram_of_text_is_a_frame(line_end: str, lines: int) -> None:
    described = PadFormat(framing="text", rows=8, columns=8)
    parser = FrameParser(described)
    with udp_pad() as (address, give), open_port(address, 9600) as opened:
        frames = []
        for counts in STREAM.counts[:5]:
            rows = counts.reshape(lines, -1).tolist()
            give(((line_end or "\n").join(" ".join(map(str, row)) for row in rows) + line_end).encode())
            frames += parser.feed(read_waiting(opened, parser), time.monotonic())
    # The first one may be the rest of a frame.
    assert [frame.pressure.tolist() for frame in frames] == STREAM.counts[1:5].tolist()


def test_a_pad_may_have_an_ipv6_address() -> None:
    try:
        listening = socket.create_server(("::1", 0), family=socket.AF_INET6)
    except OSError:
        pytest.skip("no IPv6 on this machine")
    with listening as server:
        port = server.getsockname()[1]
        with open_port(f"tcp://[::1]:{port}", 9600) as opened, server.accept()[0] as connection:
            connection.sendall(PACKETS[0])
            assert read_waiting(opened, FabricGrid()) == PACKETS[0]
    with open_port(f"udp://[::1]:{port}", 9600) as opened:
        with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sender:
            sender.sendto(PACKETS[0], ("::1", port))
        assert read_waiting(opened, FabricGrid()) == PACKETS[0]


def test_an_ftdi_adapter_is_set_to_low_latency(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []
    monkeypatch.setattr(serial.Serial, "set_low_latency_mode", lambda _, is_on: asked.append(is_on))
    with FakePort(stream_of(5), encode_fabric_grid) as port, open_port(port.path, BAUD):
        assert asked == [True]


def test_no_second_reader_takes_a_udp_pads_datagrams() -> None:
    taken = pytest.raises(SensorError, match="is open in another program")
    with udp_pad() as (address, _), open_port(address, 9600), taken as refused:
        open_port(address, 9600)
    assert refused.value.kind == "busy"


def test_a_flooding_pad_is_read_more_slowly() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with sensing(address), server.accept()[0] as connection:
            connection.settimeout(0.1)
            until_s = time.monotonic() + 1.0
            while time.monotonic() < until_s:
                with suppress(TimeoutError):
                    connection.send(b"".join(PACKETS[:300]))
            (reader,) = (thread for thread in threading.enumerate() if thread.name == "touchd-sensor")
            used = Path(f"/proc/self/task/{reader.native_id}/stat").read_text().rpartition(")")[2].split()
    # User and system time, see proc(5); without a rest it takes half a second or more.
    assert int(used[11]) + int(used[12]) < 0.25 * os.sysconf("SC_CLK_TCK")
