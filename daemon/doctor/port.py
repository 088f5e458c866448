"""The port of a pad, for `doctor` and `init`: its lasting name, who has it open, how to get permission."""

import errno
import grp
import os
import pwd
from contextlib import suppress
from pathlib import Path

from serial.tools.list_ports import comports

from touchd.drivers.pad.port import SensorError, other_ports

BY_ID, BY_PATH = Path("/dev/serial/by-id"), Path("/dev/serial/by-path")
# The kernel shows this group in place of one that a container's user namespace lacks.
OVERFLOW_GID = Path("/proc/sys/kernel/overflowgid")
SERIAL_GROUPS = ("dialout", "uucp", "plugdev")
MOST_PROGRAMS = 3


def lasting_name(port: str) -> tuple[str, str]:
    """Return the best name for a port in a configuration, and why it is that one, in a few words.

    /dev/ttyACM0 is whichever board was plugged in first, and two boards may both claim /dev/touchd-pad.
    Any other name that the user chose is returned unchanged.
    """
    is_chosen = "://" in port or (os.path.islink(port) and Path(port).name != "touchd-pad")
    if is_chosen or not os.path.exists(port):
        return port, "as given"
    device = os.path.realpath(port)
    by_number, by_socket = (
        next((str(link) for link in sorted(folder.glob("*")) if os.path.realpath(link) == device), "")
        for folder in (BY_ID, BY_PATH)
    )
    why = _why_not_by_number(device)
    if by_number and not why:
        return by_number, "it stays with this board, by its serial number"
    if by_socket:
        return by_socket, f"it stays with this socket; {why or 'it has no name by its number'}"
    return by_number or port, "the only name that it has"


def _why_not_by_number(device: str) -> str:
    """Return why a serial number does not identify a port's board; "" if it does."""
    # The two ports of one board are at the same socket.
    boards = {
        each.device: ((each.vid, each.pid, each.serial_number), str(each.location).partition(":")[0])
        for each in comports()
    }
    own, socket = boards.get(device, ((None, None, None), ""))
    if not own[2]:
        return "the board has no serial number"
    has_twin = any(board == own and place != socket for board, place in boards.values())
    return "another board has the same serial number" if has_twin else ""


def advice_for(port: str, error: SensorError) -> str:
    """Return what to do about a port that cannot be opened or read."""
    if "://" in port:
        if error.kind == "busy":
            return "end the other program (sudo ss -lunp names it), or have the board send to another port"
        missing = "is the pad's board switched on, in this network, and no other program connected to it?"
        return missing if error.kind == "missing" else ""
    if error.kind in ("busy", "shared"):
        other = programs_at(port) or f"fuser {port} shows which"
        return f"end the other program ({other}); the service ends with: sudo systemctl stop touchd"
    if error.kind == "denied":
        return group_of_the_next_login() or _how_to_get_permission(port, error.number)
    if error.number in (errno.ENXIO, errno.ENODEV):
        return (
            "it was unplugged: plug it in; a container sees it again if it has the host's /dev "
            "(-v /dev:/dev) and sensor.port is its name in /dev/serial/by-id"
        )
    advice = "plug the pad in, or name its port in sensor.port or with --port (touchd init finds it)"
    if other_ports(port):
        return advice
    return f"{advice}; this machine has no other USB serial port; on Ubuntu 22.04: sudo apt remove brltty"


def group_of_the_next_login() -> str:
    """Return that this user is in a group that may open ports but this session is not yet; "" if not so."""
    with suppress(KeyError):
        user, own = pwd.getpwuid(os.geteuid()).pw_name, {os.getegid(), *os.getgroups()}
        for group in grp.getgrall():
            if group.gr_name in SERIAL_GROUPS and user in group.gr_mem and group.gr_gid not in own:
                since = f"{user} is in the group {group.gr_name}, but this session began before that"
                return f"{since}: log out of the desktop and in again, or restart the computer"
    return ""


def _how_to_get_permission(port: str, number: int | None) -> str:
    """Return how a device may be opened: by the service, in a container, or by this user."""
    if number == errno.EPERM and "INVOCATION_ID" in os.environ:
        return (
            "the service's unit does not allow it; sudo systemctl edit touchd, add "
            f"DeviceAllow={port} rw under [Service], and sudo systemctl restart touchd"
        )
    if number == errno.EPERM:
        return f"in a container? start it with the device, as in docker run --device {port}"
    with suppress(OSError):
        # A container's user namespace lacks the device's group, so usermod cannot help.
        if os.stat(port).st_gid == int(OVERFLOW_GID.read_text()):
            return "in a rootless container? start it with --group-add keep-groups, as a user of its group"
    return (
        "add the user to the group dialout, on Arch uucp (sudo usermod -aG dialout $USER, then log out and "
        "in again) or install the udev rule systemd/99-touchd.rules"
    )


def programs_at(port: str) -> str:
    """Return the other programs that have a device open, as fuser does, as far as this user may see them."""
    found: list[str] = []
    with suppress(OSError):
        device = os.stat(port).st_rdev
        for process in sorted(Path("/proc").glob("[0-9]*")):
            # A process may have ended, or belong to another user. Follow links to devices only: a file on
            # a network that hangs would hang this thread too.
            with suppress(OSError):
                opened = [fd for fd in (process / "fd").iterdir() if os.readlink(fd).startswith("/dev/")]
                if process.name != str(os.getpid()) and any(os.stat(fd).st_rdev == device for fd in opened):
                    name = (process / "comm").read_text(errors="replace").strip()
                    found.append(f"{name}, process {process.name}")
    return ", ".join(found[:MOST_PROGRAMS])
