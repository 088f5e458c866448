"""A port's lasting name, who has it open, and what to do when it cannot be opened."""

import errno
import grp
import os
import pwd
import subprocess
import sys
from pathlib import Path

import pytest
from rigs.wait import wait_for
from serial.tools.list_ports_common import ListPortInfo

from touchd.daemon.doctor import port as doctor_port
from touchd.daemon.doctor.port import advice_for, lasting_name, programs_at
from touchd.drivers.pad.port import SensorError


class Machine:
    """Folders as in /dev, with boards on USB sockets."""

    def __init__(self, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.root = root
        self.ports: list[ListPortInfo] = []
        for name, folder in (("BY_ID", "by-id"), ("BY_PATH", "by-path")):
            (root / folder).mkdir()
            monkeypatch.setattr(doctor_port, name, root / folder)
        monkeypatch.setattr(doctor_port, "comports", lambda: self.ports)

    def plug(self, socket: str, serial: str) -> str:
        """Plug in a board; return its device. udev's name by id is the same for boards that look the same."""
        device = self.root / f"ttyACM{len(self.ports)}"
        device.touch()
        port = ListPortInfo(str(device))
        port.vid, port.pid, port.serial_number, port.location = 0x2341, 0x42, serial or None, socket
        self.ports.append(port)
        by_id = self.root / f"by-id/{serial}-if{socket.partition(':')[2]}"
        by_id.unlink(missing_ok=True)
        by_id.symlink_to(device)
        (self.root / f"by-path/{socket}").symlink_to(device)
        return str(device)


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(tmp_path, monkeypatch)


@pytest.mark.parametrize(
    ("boards", "names", "why"),
    [
        ([("1-1", "A17"), ("1-2", "B4")], ["A17-if", "B4-if"], "this board, by its serial number"),
        ([("1-1:1.0", "A17"), ("1-1:1.2", "A17")], ["A17-if1.0", "A17-if1.2"], "this board"),
        ([("1-1", ""), ("1-2", "")], ["1-1", "1-2"], "this socket; the board has no serial number"),
        ([("1-1", "1"), ("1-2", "1")], ["1-1", "1-2"], "this socket; another board has the same serial"),
    ],
    ids=["two boards", "a board with two ports", "without a number", "with the same number"],
)
def test_a_port_gets_the_name_that_lasts(
    machine: Machine, boards: list[tuple[str, str]], names: list[str], why: str
) -> None:
    found = [lasting_name(device) for device in [machine.plug(*board) for board in boards]]
    assert [Path(name).name for name, _ in found] == names
    assert all(each.startswith(f"it stays with {why}") for _, each in found)


def test_a_board_without_number_or_socket_is_named_by_id(machine: Machine) -> None:
    device = machine.plug("1-1", "")
    (machine.root / "by-path/1-1").unlink()
    assert Path(lasting_name(device)[0]).name == "-if"


def test_a_board_under_the_udev_name_gets_its_number(machine: Machine) -> None:
    link = machine.root / "touchd-pad"
    link.symlink_to(machine.plug("1-1", "A17"))
    assert Path(lasting_name(str(link))[0]).name == "A17-if"


def test_a_port_without_a_lasting_name_keeps_its_own(machine: Machine) -> None:
    uart, chosen = machine.root / "ttyAMA0", machine.root / "pad-left"
    uart.touch()
    chosen.symlink_to(machine.plug("1-1", "A17"))
    for port in (str(uart), str(chosen), "tcp://pad:4000", "/dev/touchd-none"):
        assert lasting_name(port)[0] == port


def test_the_program_that_has_a_port_is_named() -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    hold = "import os, sys, time; os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", hold, path]) as process:
        try:
            wait_for(lambda: programs_at(path))
            name = f"{Path(f'/proc/{process.pid}/comm').read_text().strip()}, process {process.pid}"
            for kind in ("busy", "shared"):
                assert advice_for(path, SensorError(kind, "")).startswith(f"end the other program ({name});")
        finally:
            process.kill()
            os.close(master)
            os.close(slave)


ACM9, PAD = "/dev/ttyACM9", "tcp://pad:4000"


@pytest.mark.parametrize(
    ("port", "kind", "number", "advice"),
    [
        (ACM9, "busy", errno.EBUSY, "end the other program (fuser /dev/ttyACM9 shows which)"),
        (ACM9, "missing", errno.ENOENT, "its port in sensor.port or with --port (touchd init finds it);"),
        (PAD, "missing", errno.ECONNREFUSED, "is the pad's board switched on, in this network, and no other"),
        ("udp://0.0.0.0:4000", "busy", errno.EADDRINUSE, "end the other program (sudo ss -lunp names it)"),
        (ACM9, "missing", errno.ENXIO, "a container sees it again if it has the host's /dev (-v /dev"),
        (ACM9, "denied", errno.EPERM, "docker run --device /dev/ttyACM9"),
        (ACM9, "denied", errno.EACCES, "the group dialout, on Arch uucp (sudo usermod -aG dialout"),
    ],
)
def test_each_fault_of_a_port_has_its_advice(
    port: str, kind: str, number: int, advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("INVOCATION_ID", raising=False)
    monkeypatch.setattr(doctor_port, "other_ports", lambda port: [])
    monkeypatch.setattr(doctor_port, "group_of_the_next_login", str)
    assert advice in advice_for(port, SensorError(kind, "", number))


def test_a_unit_that_forbids_the_device_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INVOCATION_ID", "0")
    monkeypatch.setattr(doctor_port, "group_of_the_next_login", str)
    advice = advice_for(ACM9, SensorError("denied", "", errno.EPERM))
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


def test_a_group_of_the_next_login_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    user = pwd.getpwuid(os.geteuid()).pw_name
    group = grp.struct_group(("dialout", "x", 4_000_000, [user]))
    monkeypatch.setattr(grp, "getgrall", lambda: [group])
    advice = advice_for(ACM9, SensorError("denied", "", errno.EACCES))
    assert advice.startswith(f"{user} is in the group dialout, but this session began before that: log out")
