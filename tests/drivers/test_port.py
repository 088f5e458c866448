"""A port is checked before anything starts, and each fault is reported in one line."""

import errno
import fcntl
import logging
import os
import re
import struct
import time
from pathlib import Path

import numpy as np
import pytest
import serial
from rigs.formats import encode_fabric_grid
from rigs.sensor_rig import BAUD, next_state, sensing, stream_of
from rigs.sockets import free_port

from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.pad import port as pad_port
from touchd.drivers.pad.port import SensorError, check_port, open_port

# See ioctl_tty(2); the module termios lacks it.
TIOCGEXCL = 0x80045440


def test_a_readable_port_passes_undisturbed() -> None:
    with FakePort(stream_of(5), encode_fabric_grid, speed=None) as port:
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


def test_the_ports_that_are_there_are_named_beside_one_that_is_not(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(pad_port, "DEV", tmp_path)
    for name in ("ttyUSB0", "ttyACM1", "ttyS0"):
        (tmp_path / name).touch()
    with pytest.raises(SensorError, match=rf"is not there; there is {tmp_path}/ttyACM1, {tmp_path}/ttyUSB0$"):
        open_port(f"{tmp_path}/ttyACM0", BAUD)
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


def test_a_device_that_is_not_a_terminal_is_named() -> None:
    with sensing("/dev/null") as queue:
        assert "/dev/null cannot be opened" in next_state(queue).reason


def test_missing_permission_is_said_until_it_is_there(caplog: pytest.LogCaptureFixture) -> None:
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
        # Root may open an exclusive device all the same, so ask the kernel.
        monkeypatch.setattr(os.path, "realpath", lambda port: "/dev/ttyACM0" if port == path else port)
        with open_port(path, BAUD):
            assert is_exclusive()
    finally:
        os.close(master)
        os.close(slave)
