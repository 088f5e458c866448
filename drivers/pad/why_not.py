"""Why a port cannot be opened or read: from the error, the device's node and the programs that hold it."""

import errno
import grp
import os
import re
import stat
import time
from pathlib import Path

from touchd.drivers.errors import TouchdError
from touchd.drivers.pad.arrived import looks_like

NOT_THERE = {errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.EIO, errno.ECONNREFUSED, errno.EHOSTUNREACH}
NOT_ALLOWED = {errno.EACCES, errno.EPERM}
# EAGAIN is what pyserial's lock reports when another program that locks, as touchd does, has the port open.
IN_USE = {errno.EBUSY, errno.EAGAIN, errno.EADDRINUSE}
# udev removes the node of an unplugged device within this time.
NODE_GONE_S = 0.3
SERIAL_GROUPS = ("dialout", "uucp", "plugdev")
MOST_PROGRAMS = 3


class ClosedAtOnceError(ConnectionError):
    """The other end closed the connection after it had sent nothing, or a few words: the argument."""


class SensorError(TouchdError):
    """The port cannot be used; the message says why and what to do.

    kind: "missing", "denied", "busy", "shared" (another program takes bytes from it) or "unusable".
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


def why_not_opened(port: str, error: Exception) -> SensorError:
    """Explain why opening or checking a port failed."""
    number = error.errno if isinstance(error, OSError) else None
    if isinstance(error, ConnectionResetError):
        return _closed_at_once(port, b"")
    if number in NOT_THERE:
        question = "is the pad plugged in and switched on?" if "/" in port else "name it as in /dev/ttyACM0."
        question += "".join(f" There is {name}." for name in sorted(Path("/dev").glob("tty[AU][CS][MB]*")))
        if "://" in port:
            question = "is the pad's board switched on, and in this network?"
        return SensorError("missing", f"{port} is not there: {question}")
    if number in NOT_ALLOWED:
        return SensorError("denied", f"no permission to open {port}: {_how_to_get_permission(port, number)}")
    if number in IN_USE:
        hint = str(error) if "://" in port else programs_at(port) or f"fuser {port} shows which"
        return SensorError("busy", f"{port} is busy: another program reads it ({hint})")
    if "://" not in port and os.path.exists(port) and not stat.S_ISCHR(os.stat(port).st_mode):
        return SensorError("unusable", f"{port} is not a serial port: name a device like /dev/ttyACM0")
    return SensorError("unusable", f"{port} cannot be opened: {error}")


def why_not_read(port: str, error: Exception) -> SensorError:
    """Explain why reading an opened port failed: the device, or the other end of the connection, is gone."""
    if isinstance(error, ClosedAtOnceError):
        return _closed_at_once(port, *error.args)
    if "://" not in port:
        time.sleep(NODE_GONE_S)
        if os.path.exists(port):
            what = "hung up, and is there again: did its board restart, or its plug come loose?"
            return SensorError("missing", f"{port} {what}")
    return SensorError("missing", f"{port} went away: unplugged or switched off?")


def _closed_at_once(port: str, sent: bytes) -> SensorError:
    what = f"sent {looks_like(sent)}, and closed it" if sent else "closed it without a byte"
    advice = "does it serve one program at a time, and is another one connected?"
    return SensorError("busy", f"{port} took the connection and {what}: {advice}")


def shared(port: str, programs: str) -> SensorError:
    """Return an error that says that other programs take bytes of a port. programs: which, "" if not seen."""
    who = programs or f"fuser {port} shows which"
    return SensorError("shared", f"{port}: another program reads it too, and takes bytes ({who}); end it")


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
    group = _group_of(node)
    return (
        f"add the user to the group {group} (sudo usermod -aG {group} $USER, then log in again) or install "
        "the udev rule systemd/99-touchd.rules"
    )


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
