"""A port that cannot be opened or read says which of the possible causes it is."""

import errno
import logging
import os
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.sensor_rig import BAUD, next_frames, next_state, sensing, stream_of
from rigs.wait import wait_for

from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.pad.port import SensorError, check_port, open_port
from touchd.drivers.pad.sensor import FrameQueue, Sensor
from touchd.drivers.pad.why_not import programs_at, why_not_opened

STEAL = """
import os, select, sys
line = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
while True:
    select.select([line], [], [])
    try: os.read(line, 4096)
    except BlockingIOError: pass
"""


@contextmanager
def other_reader(path: str) -> Iterator[subprocess.Popen[bytes]]:
    """Read a port from another process."""
    with subprocess.Popen([sys.executable, "-c", STEAL, path]) as process:
        try:
            wait_for(lambda: programs_at(path))
            yield process
        finally:
            process.kill()


def test_another_program_that_takes_bytes_is_named_until_it_ends(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with FakePort(stream_of(), encode_fabric_grid) as port, sensing(port.path) as queue:
        next_frames(queue, 5)
        with other_reader(port.path) as process:
            down = next_state(queue)
            name = Path(f"/proc/{process.pid}/comm").read_text().strip()
            who = f"{name}, process {process.pid}"
            assert (
                down.reason == f"{port.path}: another program reads it too, and takes bytes ({who}); end it"
            )
            # The port is not opened again while the other program has it: that would restart an Arduino.
            time.sleep(1.0)
            assert len(queue) == 0
        assert next_state(queue).state == "up"
        next_frames(queue, 5)


def test_the_program_that_locked_a_port_is_named() -> None:
    lock = "import serial, sys, time; line = serial.Serial(sys.argv[1], exclusive=True); time.sleep(60)"
    with (
        FakePort(stream_of(), encode_fabric_grid) as port,
        subprocess.Popen([sys.executable, "-c", lock, port.path]) as process,
    ):
        wait_for(lambda: programs_at(port.path))
        with pytest.raises(
            SensorError, match=rf"busy: another program reads it \(.*, process {process.pid}\)"
        ):
            wait_for(lambda: open_port(port.path, BAUD).close())
        process.kill()


def test_without_a_view_of_other_programs_fuser_is_advised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchd.drivers.pad.why_not.programs_at", lambda port: "")
    with (
        FakePort(stream_of(), encode_fabric_grid) as port,
        serial.Serial(port.path, exclusive=True),
        pytest.raises(SensorError, match=f"fuser {port.path}"),
    ):
        open_port(port.path, BAUD)


def test_a_server_that_closes_at_once_is_told_from_a_lost_pad() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with sensing(address) as queue:
            server.accept()[0].close()
            closed = next_state(queue)
            assert closed.reason.startswith(f"{address} took the connection and closed it without a byte: ")
            connection, _ = server.accept()
            # A reset instead of an end, as from a board that crashes.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            connection.close()
            connection, _ = server.accept()
            for number, counts in enumerate(stream_of(20).counts):
                connection.sendall(encode_fabric_grid(counts, 18 * number))
            assert next_state(queue).state == "up"
            connection.close()
            assert next_state(queue).reason == f"{address} went away: unplugged or switched off?"


@pytest.mark.parametrize(
    ("sent", "shown"),
    [
        (b"Port already in use\r\n", "text, such as 'Port already in use'"),
        (encode_fabric_grid(stream_of(1).counts[0], 18)[:150], "bytes that are not text, such as "),
    ],
    ids=["busy", "half a frame"],
)
def test_a_server_that_closes_before_a_frame_is_quoted(sent: bytes, shown: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with sensing(address) as queue:
            connection, _ = server.accept()
            connection.sendall(sent)
            connection.close()
            reason = next_state(queue).reason
    assert reason.startswith(f"{address} took the connection and sent {shown}")
    assert "and closed it: does it serve one program at a time" in reason


def test_a_connection_that_is_reset_at_once_was_not_refused() -> None:
    error = why_not_opened(
        "tcp://pad:4000", ConnectionResetError(errno.ECONNRESET, "Connection reset by peer")
    )
    assert "took the connection and closed it without a byte" in str(error)


def test_a_port_that_hangs_up_but_is_there_is_not_unplugged(tmp_path: Path) -> None:
    link = tmp_path / "pad"
    first, second = (FakePort(stream_of(), encode_fabric_grid) for _ in range(2))
    link.symlink_to(first.path)
    with first, second, sensing(str(link)) as queue:
        next_frames(queue, 5)
        (new := tmp_path / "new").symlink_to(second.path)
        new.replace(link)
        first.stop()
        assert "hung up, and is there again" in next_state(queue).reason


@pytest.fixture
def a_denied_port(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A device whose mode allows everything, and which the system refuses all the same."""

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    master, slave = os.openpty()
    monkeypatch.setattr(serial, "serial_for_url", refuse)
    monkeypatch.delenv("INVOCATION_ID", raising=False)
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_a_unit_that_forbids_a_device_gets_the_line_to_add(
    a_denied_port: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("INVOCATION_ID", "0" * 32)
    # In /proc/devices, pseudo-terminals are "pts".
    monkeypatch.setattr(os.path, "realpath", lambda port: "/dev/pts0")
    with pytest.raises(
        SensorError, match=r"no permission to open .*DeviceAllow=char-pts rw under \[Service\]"
    ):
        open_port(a_denied_port, BAUD)


def test_a_container_without_the_device_is_named(a_denied_port: str) -> None:
    with pytest.raises(SensorError, match=f"docker run --device {a_denied_port}"):
        open_port(a_denied_port, BAUD)


def test_a_check_names_the_container_whose_rules_deny_access(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("INVOCATION_ID", raising=False)
    # As the system answers where a control group denies the device.
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    with (
        FakePort(stream_of(), encode_fabric_grid) as port,
        pytest.raises(SensorError, match=f"docker run --device {port.path}"),
    ):
        check_port(port.path, BAUD)


def test_the_group_that_owns_the_device_is_named(a_denied_port: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Uucp:
        gr_name = "uucp"

    mode = stat.S_IFCHR | 0o660
    node = os.stat_result((mode, 1, 1, 1, 0, 14, 0, 0, 0, 0))
    monkeypatch.setattr(os, "stat", lambda path: node)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    monkeypatch.setattr(serial, "serial_for_url", lambda *_, **__: None)
    monkeypatch.setattr("grp.getgrgid", lambda gid: Uucp)
    with pytest.raises(SensorError, match=r"group uucp .*usermod -aG uucp"):
        check_port("/dev/ttyACM0", BAUD)


def test_a_board_that_stays_silent_needs_a_person() -> None:
    # The system takes the connections.
    with socket.create_server(("127.0.0.1", 0), backlog=20) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with sensing(address, silence_s=0.1, reopen_after_s=0.4) as queue:
            assert "no data for 0.1 s" in next_state(queue).reason
            assert next_state(queue).reason == (
                f"{address}: the board takes the port but says nothing, also after it was opened again; "
                "switch it off and on"
            )


def test_the_rate_that_starts_boot_loaders_is_warned_of_once(caplog: pytest.LogCaptureFixture) -> None:
    for port, baud in (("/dev/touchd-none", 1200), ("/dev/touchd-none", 9600), ("tcp://127.0.0.1:1", 1200)):
        sensor = Sensor(port, baud, FabricGrid(), FrameQueue())
        sensor.start()
        sensor.stop()
    (warning,) = [message for message in caplog.messages if "boot loader" in message]
    assert warning.startswith("/dev/touchd-none: closing a port at 1200 baud")


def test_no_module_is_imported_when_frames_stop() -> None:
    # An upgrade may have replaced the files of a daemon that runs.
    count = """
import sys
from touchd.drivers.pad.sensor import FrameQueue, Sensor
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.format import PRESETS
sensor = Sensor("/dev/none", 9600, FrameParser(PRESETS["csv"]), FrameQueue())
before = set(sys.modules)
for recent in (b"", b"boot\\n" * 9, b"\\xff" * 400):
    sensor._report_no_frames(recent, is_silent=not recent)
print(sorted(name for name in set(sys.modules) - before if name.startswith("touchd")))
"""
    done = subprocess.run([sys.executable, "-c", count], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
