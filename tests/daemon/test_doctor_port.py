"""A port's lasting name, who has it open, and what to do when it cannot be opened."""

import errno
import grp
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rigs.wait import wait_for

from touchd.daemon.doctor import port as doctor_port
from touchd.daemon.doctor.port import LastingName, advice_for, lasting_name, programs_at, why_no_port
from touchd.drivers.pad.port import SensorError


class Machine:
    """Folders as in /dev/serial and /sys, with boards on USB sockets."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for folder in ("dev/by-id", "dev/by-path", "sys/class/tty"):
            (root / folder).mkdir(parents=True)

    def plug(self, tty: str, socket: str, serial: str, kind: str = "2341 0042", interface: int = 0) -> str:
        """Plug in a board; return its device. udev's name by id is the same for boards that look the same."""
        device = self.root / "dev" / tty
        device.touch()
        board = self.root / "sys/devices/usb" / socket
        (board / f"{socket}:1.{interface}/tty/{tty}").mkdir(parents=True)
        for name, text in zip(("idVendor", "idProduct"), kind.split(), strict=True):
            (board / name).write_text(f"{text}\n")
        if serial:
            (board / "serial").write_text(f"{serial}\n")
        entry = self.root / "sys/class/tty" / tty
        entry.mkdir()
        (entry / "device").symlink_to(board / f"{socket}:1.{interface}")
        by_id = self.root / f"dev/by-id/usb-{kind.replace(' ', '_')}_{serial}-if0{interface}"
        by_id.unlink(missing_ok=True)
        by_id.symlink_to(device)
        (self.root / f"dev/by-path/pci-usb-{socket}-{interface}").symlink_to(device)
        return str(device)

    def name(self, port: str) -> LastingName:
        dev = self.root / "dev"
        return lasting_name(port, dev / "by-id", dev / "by-path", self.root / "sys/class/tty")


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_a_board_with_a_serial_number_is_named_by_it(machine: Machine) -> None:
    first, second = machine.plug("ttyACM0", "1-1", "A17"), machine.plug("ttyACM1", "1-2", "B4")
    for device, number in ((first, "A17"), (second, "B4")):
        name = machine.name(device)
        assert (Path(name.port).name, "serial number" in name.why) == (f"usb-2341_0042_{number}-if00", True)


@pytest.mark.parametrize("serial", ["", "0001"], ids=["without a number", "with the same number"])
def test_boards_that_look_the_same_are_named_by_their_socket(machine: Machine, serial: str) -> None:
    devices = [machine.plug(f"ttyUSB{n}", f"1-{n}", serial, "1a86 7523") for n in range(2)]
    names = [machine.name(device) for device in devices]
    assert [Path(name.port).name for name in names] == ["pci-usb-1-0-0", "pci-usb-1-1-0"]
    assert all(name.why.startswith("it stays with this socket; ") for name in names)


def test_a_board_without_a_number_or_socket_has_its_name_by_id(machine: Machine) -> None:
    device = machine.plug("ttyUSB0", "1-1", "", "1a86 7523")
    (machine.root / "dev/by-path/pci-usb-1-1-0").unlink()
    assert Path(machine.name(device).port).name == "usb-1a86_7523_-if00"


def test_a_board_with_the_udev_rules_name_is_named_by_its_number(machine: Machine) -> None:
    link = machine.root / "dev/touchd-pad"
    link.symlink_to(machine.plug("ttyACM0", "1-1", "A17"))
    assert Path(machine.name(str(link)).port).name == "usb-2341_0042_A17-if00"


def test_a_port_without_another_name_keeps_its_own(machine: Machine, tmp_path: Path) -> None:
    uart, chosen = tmp_path / "dev/ttyAMA0", tmp_path / "dev/pad-left"
    uart.touch()
    chosen.symlink_to(machine.plug("ttyACM0", "1-1", "A17"))
    for port in (str(uart), str(chosen), "tcp://pad:4000", "/dev/touchd-none"):
        assert machine.name(port).port == port


def test_an_adapter_without_a_port_is_named(machine: Machine) -> None:
    usb = machine.root / "sys/devices/usb"
    assert why_no_port(usb) == ""
    machine.plug("ttyACM0", "1-1", "A17")
    machine.plug("ttyUSB0", "1-2", "", "1a86 7523")
    assert why_no_port(usb) == ""
    (usb / "1-2/1-2:1.0/tty/ttyUSB0").rmdir()
    (usb / "1-2/1-2:1.0/tty").rmdir()
    assert "the USB adapter 1a86:7523 is plugged in, but has no port; " in why_no_port(usb)


@contextmanager
def pty_in_another_program() -> Iterator[tuple[str, int]]:
    """Yield a pseudo-terminal that another program has open, and that program's number."""
    master, slave = os.openpty()
    path = os.ttyname(slave)
    hold = "import os, sys, time; os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", hold, path]) as process:
        try:
            wait_for(lambda: programs_at(path))
            yield path, process.pid
        finally:
            process.kill()
            os.close(master)
            os.close(slave)


@pytest.mark.parametrize("kind", ["busy", "shared"])
def test_the_program_that_has_a_port_is_named(kind: str) -> None:
    with pty_in_another_program() as (path, number):
        name = Path(f"/proc/{number}/comm").read_text().strip()
        assert advice_for(path, SensorError(kind, "")) == f"end the other program ({name}, process {number})"


def test_without_a_view_of_other_programs_fuser_is_advised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_port, "programs_at", lambda port: "")
    advice = advice_for("/dev/ttyACM0", SensorError("busy", ""))
    assert advice == "end the other program (fuser /dev/ttyACM0 shows which)"


@pytest.mark.parametrize(
    ("port", "kind", "number", "advice"),
    [
        ("/dev/ttyACM9", "missing", errno.ENOENT, "plug the pad in, or name its port in sensor.port or with"),
        ("/dev/ttyACM9", "missing", errno.ENOENT, "this machine has no other USB serial port"),
        (
            "tcp://pad:4000",
            "missing",
            errno.ECONNREFUSED,
            "is the pad's board switched on, in this network, and no other program connected to it?",
        ),
        (
            "/dev/ttyACM9",
            "missing",
            errno.ENXIO,
            "a container sees it again if it has the host's /dev (-v /dev",
        ),
        ("/dev/ttyACM9", "denied", errno.EPERM, "docker run --device /dev/ttyACM9"),
        (
            "/dev/ttyACM9",
            "denied",
            errno.EACCES,
            "the group dialout (sudo usermod -aG dialout",
        ),
    ],
)
def test_each_fault_of_a_port_has_its_advice(
    port: str, kind: str, number: int | None, advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("INVOCATION_ID", raising=False)
    monkeypatch.setattr(doctor_port, "other_ports", lambda port: [])
    monkeypatch.setattr(doctor_port, "group_of_the_next_login", str)
    assert advice in advice_for(port, SensorError(kind, "", number))


def test_a_unit_that_forbids_the_device_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INVOCATION_ID", "0")
    monkeypatch.setattr(doctor_port, "group_of_the_next_login", str)
    advice = advice_for("/dev/ttyACM9", SensorError("denied", "", errno.EPERM))
    assert "sudo systemctl edit touchd, add DeviceAllow=/dev/ttyACM9 rw under [Service]" in advice


def test_a_group_that_a_container_lacks_is_not_advised(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "overflowgid").write_text(f"{tmp_path.stat().st_gid}\n")
    monkeypatch.setattr(doctor_port, "OVERFLOW_GID", tmp_path / "overflowgid")
    monkeypatch.setattr(doctor_port, "group_of_the_next_login", str)
    advice = advice_for(str(tmp_path), SensorError("denied", "", errno.EACCES))
    assert "start it with --group-add keep-groups" in advice
    assert "usermod" not in advice


def test_the_group_of_the_device_is_advised(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    uucp = grp.struct_group(("uucp", "x", 14, []))
    monkeypatch.setattr(grp, "getgrgid", lambda _: uucp)
    monkeypatch.setattr(doctor_port, "group_of_the_next_login", str)
    advice = advice_for(str(tmp_path), SensorError("denied", "", errno.EACCES))
    assert "sudo usermod -aG uucp $USER" in advice
