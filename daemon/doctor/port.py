"""The port of a pad, for `doctor` and `init`: its lasting name, who has it open, how to get permission."""

import errno
import grp
import os
import pwd
import re
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from touchd.drivers.pad.port import SensorError, other_ports

BY_ID, BY_PATH = Path("/dev/serial/by-id"), Path("/dev/serial/by-path")
TTY, USB = Path("/sys/class/tty"), Path("/sys/bus/usb/devices")
# Adapters from USB to serial, as in the udev rule: CH340, CP210x, FTDI, PL2303.
ADAPTERS = re.compile(r"1a86:(5523|752[23]|55d.)|10c4:ea(60|70|71)|0403:60(01|1[0145])|067b:2...")
# The kernel shows this group in place of one that a container's user namespace lacks.
OVERFLOW_GID = Path("/proc/sys/kernel/overflowgid")
SERIAL_GROUPS = ("dialout", "uucp", "plugdev")
MOST_PROGRAMS = 3


class LastingName(NamedTuple):
    """A port's name for a configuration, and why it is that one, in a few words."""

    port: str
    why: str


class Board(NamedTuple):
    """A USB board: its place in /sys, vendor, product, and serial number, "" if it has none."""

    place: Path
    vendor: str
    product: str
    serial: str


def lasting_name(port: str, by_id: Path = BY_ID, by_path: Path = BY_PATH, tty: Path = TTY) -> LastingName:
    """Return the best name for a port.

    /dev/ttyACM0 is whichever board was plugged in first, and two boards may both claim /dev/touchd-pad.
    A name that the user chose, other than these, is returned as it is.
    """
    is_chosen = "://" in port or (os.path.islink(port) and Path(port).name != "touchd-pad")
    if is_chosen or not os.path.exists(port):
        return LastingName(port, "as given")
    device = os.path.realpath(port)
    why = _why_not_by_number(Path(device).name, tty)
    if not why and (name := _link_to(device, by_id)):
        return LastingName(name, "it stays with this board, by its serial number")
    if name := _link_to(device, by_path):
        return LastingName(name, f"it stays with this socket; {why or 'it has no name by its number'}")
    if name := _link_to(device, by_id):
        return LastingName(name, f"it stays with this kind of board; {why}")
    return LastingName(port, "the only name that it has")


def _why_not_by_number(name: str, tty: Path) -> str:
    """Say why a port's board cannot be told by its serial number; "" if it can."""
    boards = {entry.name: board for entry in tty.glob("*") if (board := _board_of(entry)) is not None}
    own = boards.get(name)
    if own is None or not own.serial:
        return "the board has no serial number"
    is_alike = any(board[1:] == own[1:] and board != own for board in boards.values())
    return "another board has the same serial number" if is_alike else ""


def why_no_port(usb: Path = USB) -> str:
    """Say which USB adapter is plugged in but has no port, and what to do; "" if there is none.

    brltty, which Ubuntu 22.04 and others install, takes some of them for a Braille display.
    """
    for device in sorted(usb.glob("*")):
        kind = f"{_text(device / 'idVendor')}:{_text(device / 'idProduct')}"
        if ADAPTERS.fullmatch(kind) and not any(device.glob("*:*/tty*")):
            return (
                f"the USB adapter {kind} is plugged in, but has no port; if `sudo dmesg` says that brltty "
                "took it: sudo apt remove brltty, and plug it in again"
            )
    return ""


def _link_to(device: str, folder: Path) -> str | None:
    """Return the first link in a folder that leads to a device."""
    links = sorted(folder.glob("*")) if folder.is_dir() else []
    return next((str(link) for link in links if os.path.realpath(link) == device), None)


def _board_of(entry: Path) -> Board | None:
    """Return the USB board of an entry in /sys/class/tty, None for another kind of port."""
    place = Path(os.path.realpath(entry / "device"))
    for folder in (place, *place.parents):
        if (folder / "idVendor").exists():
            return Board(folder, *(_text(folder / name) for name in ("idVendor", "idProduct", "serial")))
    return None


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""


def advice_for(port: str, error: SensorError) -> str:
    """Say what to do about a port that cannot be opened or read."""
    if "://" in port:
        missing = "is the pad's board switched on, in this network, and no other program connected to it?"
        return missing if error.kind == "missing" else ""
    if error.kind in ("busy", "shared"):
        return f"end the other program ({programs_at(port) or f'fuser {port} shows which'})"
    if error.kind == "denied":
        return group_of_the_next_login() or _how_to_get_permission(port, error.number)
    if error.number in (errno.ENXIO, errno.ENODEV):
        return (
            "it was unplugged: plug it in; a container sees it again if it has the host's /dev "
            "(-v /dev:/dev) and sensor.port is its name in /dev/serial/by-id"
        )
    advice = "plug the pad in, or name its port in sensor.port or with --port"
    if not other_ports(port):
        advice += "; this machine has no other USB serial port"
    return "; ".join(filter(None, (advice, why_no_port())))


def group_of_the_next_login() -> str:
    """Say that this user is in a group that may open ports, but this session is not yet; "" if not so."""
    with suppress(KeyError):
        user, own = pwd.getpwuid(os.geteuid()).pw_name, {os.getegid(), *os.getgroups()}
        for group in grp.getgrall():
            if group.gr_name in SERIAL_GROUPS and user in group.gr_mem and group.gr_gid not in own:
                since = f"{user} is in the group {group.gr_name}, but this session began before that"
                return f"{since}: log out of the desktop and in again, or restart the computer"
    return ""


def _how_to_get_permission(port: str, number: int | None) -> str:
    if number == errno.EPERM and "INVOCATION_ID" in os.environ:
        return (
            "the service's unit does not allow it; sudo systemctl edit touchd, add "
            f"DeviceAllow={port} rw under [Service], and sudo systemctl restart touchd"
        )
    if number == errno.EPERM:
        return f"in a container? start it with the device, as in docker run --device {port}"
    if _is_of_no_group_here(port):
        return (
            "in a rootless container? start it with --group-add keep-groups, as a user of the device's group"
        )
    group = _group_of(port)
    return (
        f"add the user to the group {group} (sudo usermod -aG {group} $USER, then log out and in again) or "
        "install the udev rule systemd/99-touchd.rules"
    )


def _is_of_no_group_here(port: str) -> bool:
    """Whether a device's group does not exist in this user namespace; usermod cannot help then."""
    with suppress(OSError):
        return os.stat(port).st_gid == int(OVERFLOW_GID.read_text())
    return False


def _group_of(port: str) -> str:
    """Return the group that may open serial devices here: dialout, on Arch uucp."""
    with suppress(KeyError, OSError):
        if (name := grp.getgrgid(os.stat(port).st_gid).gr_name) in SERIAL_GROUPS:
            return name
    return SERIAL_GROUPS[0]


def programs_at(port: str) -> str:
    """Return the other programs that have a device open, as fuser does, as far as this user may see them."""
    found: list[str] = []
    with suppress(OSError):
        device = os.stat(port).st_rdev
        for process in sorted(Path("/proc").glob("[0-9]*")):
            # A process may end while it is looked at, or belong to another user.
            with suppress(OSError):
                if process.name != str(os.getpid()) and _has_open(process, device):
                    name = (process / "comm").read_text(errors="replace").strip()
                    found.append(f"{name}, process {process.name}")
    return ", ".join(found[:MOST_PROGRAMS])


def _has_open(process: Path, device: int) -> bool:
    # Follow only links to devices: a file on a network that hangs would hang this thread too.
    return any(
        os.readlink(fd).startswith("/dev/") and os.stat(fd).st_rdev == device
        for fd in (process / "fd").iterdir()
    )
