"""The port of a pad, for `doctor` and `init`: its lasting name, who has it open, how to get permission."""

import errno
import grp
import os
import pwd
import re
import stat
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from touchd.drivers.pad.port import SensorError, other_ports

BY_ID, BY_PATH = Path("/dev/serial/by-id"), Path("/dev/serial/by-path")
TTY, USB = Path("/sys/class/tty"), Path("/sys/bus/usb/devices")
# Adapters from USB to serial, as in the udev rule: CH340, CP210x, FTDI, PL2303.
ADAPTERS = re.compile(r"1a86:(5523|752[23]|55d.)|10c4:ea(60|70|71)|0403:60(01|1[0145])|067b:2...")
# Arduino and Teensy: the udev rule gives their boards the name /dev/touchd-pad.
VENDORS_OF_THE_RULE = {"2341", "2a03", "16c0"}
SERIAL_GROUPS = ("dialout", "uucp", "plugdev")
MOST_PROGRAMS = 3
# In a user namespace without the host's groups, as of a rootless container, this group owns what they own.
OVERFLOW_GROUP = Path("/proc/sys/kernel/overflowgid")


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
    device = os.path.realpath(port)
    is_link = "://" not in port and os.path.islink(port) and Path(port).name != "touchd-pad"
    if "://" in port or is_link or not os.path.exists(port):
        return LastingName(port, "as given")
    boards = {entry.name: board for entry in tty.glob("*") if (board := _board_of(entry)) is not None}
    own = boards.get(Path(device).name)
    others = {board for board in boards.values() if own and board.place != own.place}
    alike = [board for board in others if own and (board.vendor, board.product) == (own.vendor, own.product)]
    rivals = [board for board in others if board in alike or board.vendor in VENDORS_OF_THE_RULE]
    if os.path.islink(port) and not rivals:
        return LastingName(port, "the name that the udev rule gives this board")
    has_number = own is not None and own.serial and own.serial not in {board.serial for board in alike}
    if has_number and (name := _link_to(device, by_id)):
        return LastingName(name, "it stays with this board, by its serial number")
    if name := _link_to(device, by_path):
        why = (
            "another board has the same serial number"
            if own and own.serial
            else "the board has no serial number"
        )
        return LastingName(name, f"it stays with this socket; {why}")
    return LastingName(port, "the only name that it has")


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
    if error.number == errno.ENXIO:
        advice = "plug the pad in; in a container, give it the folder /dev/serial/by-id and name a port there"
    else:
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
    node = os.stat(port) if os.path.exists(port) else None
    if number == errno.EPERM or (node is not None and _mode_allows(node)):
        # The node's mode allows it; a rule of systemd or of a container does not.
        if "INVOCATION_ID" not in os.environ:
            return f"in a container? start it with the device, as in docker run --device {port}"
        allow = f"DeviceAllow={_device_class(port, node)} rw"
        return (
            f"the service's unit does not allow it; sudo systemctl edit touchd, add {allow} under [Service], "
            "and sudo systemctl restart touchd"
        )
    if node is not None and node.st_gid == _overflow_group():
        return "in a rootless container: start it with --group-add keep-groups, in the device's group"
    group = _group_of(node)
    return (
        f"add the user to the group {group} (sudo usermod -aG {group} $USER, then log out and in again) or "
        "install the udev rule systemd/99-touchd.rules"
    )


def _overflow_group() -> int | None:
    """Return the group that stands for those which this namespace does not know, None outside of one."""
    with suppress(OSError, ValueError):
        is_outside = Path("/proc/self/gid_map").read_text().split()[2] == str(2**32 - 1)
        return None if is_outside else int(OVERFLOW_GROUP.read_text())
    return None


def programs_at(port: str) -> str:
    """Return the other programs that have a device open, as fuser does, as far as this user may see them."""
    try:
        device = os.stat(port).st_rdev
    except OSError:
        return ""
    # A process may end while it is looked at, or belong to another user.
    found = [process for process in sorted(Path("/proc").glob("[0-9]*")) if _has_open(process, device)]
    return ", ".join(map(_named, found[:MOST_PROGRAMS]))


def _has_open(process: Path, device: int) -> bool:
    if process.name == str(os.getpid()):
        return False
    try:
        # Follow only links to devices: a file on a network that hangs would hang this thread too.
        return any(
            os.readlink(fd).startswith("/dev/") and os.stat(fd).st_rdev == device
            for fd in (process / "fd").iterdir()
        )
    except OSError:
        return False


def _named(process: Path) -> str:
    try:
        name = (process / "comm").read_text(errors="replace").strip()
    except OSError:
        name = "a program"
    return f"{name}, process {process.name}"


def _mode_allows(node: os.stat_result) -> bool:
    """Whether a node's owner, group and mode allow it. `os.access` asks a container's rules, too."""
    shift = 6 if node.st_uid == os.geteuid() else 3 * (node.st_gid in (os.getegid(), *os.getgroups()))
    return os.geteuid() == 0 or node.st_mode >> shift & 6 == 6


def _group_of(node: os.stat_result | None) -> str:
    """Return the group that may open serial devices here: dialout, on Arch uucp."""
    try:
        name = grp.getgrgid(node.st_gid).gr_name if node is not None else ""
    except KeyError:
        name = ""
    return name if name in SERIAL_GROUPS else SERIAL_GROUPS[0]


def _device_class(port: str, node: os.stat_result | None) -> str:
    """Return what systemd's DeviceAllow takes: the driver's name in /proc/devices, else the device's path."""
    if node is None or not stat.S_ISCHR(node.st_mode):
        return port
    characters = Path("/proc/devices").read_text().partition("Block devices:")[0]
    names = re.findall(rf"^ *{os.major(node.st_rdev)} (\S+)$", characters, re.MULTILINE)
    # Major 4 is shared by virtual consoles and the serial ports of a mainboard.
    fitting = [name for name in names if Path(os.path.realpath(port)).name.startswith(name)]
    return f"char-{max(fitting, key=len)}" if fitting else os.path.realpath(port)
