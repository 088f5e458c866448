"""The port of a pad: opening and reading it, and its errors in words.

A port is a serial device; over TCP, touchd connects to the pad; over UDP, it listens for what the pad sends.
"""

import contextlib
import errno
import fcntl
import os
import re
import select
import socket
import stat
import termios
from pathlib import Path
from typing import TypeAlias

import serial

from touchd.drivers import hosts
from touchd.drivers.errors import TouchdError
from touchd.drivers.pad.parser import FrameParser

READ_TIMEOUT_S = 0.1
READ_BYTES = 65536
CONNECT_S = 3.0
ADDRESS = re.compile(r"(tcp|udp)://(\[[^\s\]]+\]|[^\s/:?]+)(?::(\d{0,5}))?")
DEV = Path("/dev")
# What an error number means for a port: the kind of fault, and words that follow the port's name.
FAULTS: dict[int | None, tuple[str, str]] = {
    errno.ENOENT: ("missing", "is not there"),
    errno.ENODEV: ("missing", "has no device any more"),
    errno.ENXIO: ("missing", "has no device any more"),
    errno.EIO: ("missing", "went away: unplugged or switched off?"),
    errno.ECONNRESET: ("missing", "closed the connection"),
    errno.ECONNREFUSED: ("missing", "refuses the connection"),
    errno.EHOSTUNREACH: ("missing", "cannot be reached"),
    errno.ENETUNREACH: ("missing", "cannot be reached"),
    errno.EACCES: ("denied", "may not be opened by this user"),
    errno.EPERM: ("denied", "may not be opened by this user"),
    errno.EBUSY: ("busy", "is open in another program"),
    # What pyserial's lock reports when another program that locks, as touchd does, has the port open.
    errno.EAGAIN: ("busy", "is open in another program"),
    errno.EADDRINUSE: ("busy", "is open in another program"),
    errno.EADDRNOTAVAIL: (
        "unusable",
        "is not an address of this computer, where touchd listens for the board; use udp://0.0.0.0",
    ),
    errno.ENOTTY: ("unusable", "is not a serial port: name a device like /dev/ttyACM0"),
}


class SensorError(TouchdError):
    """The port cannot be used; `touchd doctor` says what to do.

    kind: "missing", "denied", "busy", "shared" (another program takes bytes from it) or "unusable".
    number: the system's, None without one.
    """

    def __init__(self, kind: str, message: str, number: int | None = None) -> None:
        super().__init__(message)
        self.kind = kind
        self.number = number


def sensor_error(port: str, error: Exception) -> SensorError:
    """Return an error of opening or reading a port in words."""
    number = error.errno if isinstance(error, OSError) else None
    words = getattr(error, "strerror", None) or error
    other = "missing" if isinstance(error, OSError) and "://" in port else "unusable"
    kind, what = FAULTS.get(number, (other, f"cannot be opened: {words}"))
    others = ", ".join(other_ports(port)) if kind == "missing" else ""
    return SensorError(kind, f"{port} {what}{others and f'; there is {others}'}", number)


def other_ports(port: str) -> list[str]:
    """Return the USB serial ports of this computer, other than a port; none for an address."""
    found = [] if "://" in port else map(str, DEV.glob("tty[AU][CS][MB]*"))
    return sorted(each for each in found if each != port)


def at_baud(port: str, baud: int) -> str:
    """Return " at 512000 baud", for people, or nothing where the port is an address and has none."""
    return "" if "://" in port else f" at {baud} baud"


def address_of(port: str) -> tuple[str, str, int]:
    """Return "tcp" or "udp", host and number of a pad's address on the network; raises ValueError."""
    match = ADDRESS.fullmatch(port.strip())
    if match is not None and not match[3]:
        raise ValueError(f"lacks its port; write it as in {port.strip().rstrip(':')}:4000")
    if match is None or int(match[3]) > 65535:
        raise ValueError("not an address such as tcp://192.168.1.20:4000 or udp://0.0.0.0:4000")
    return match[1], match[2].strip("[]"), int(match[3])


class NetworkPort:
    """A pad on the network, read as a serial port is; raises OSError."""

    baudrate = 0

    def __init__(self, port: str) -> None:
        protocol, host, number = address_of(port)
        self.port = port
        self.is_stream = protocol == "tcp"
        if self.is_stream:
            self._socket = hosts.connect(host, number, CONNECT_S)
        else:
            self._socket = socket.socket(
                socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM
            )
            try:
                self._socket.bind((host, number))
            except OSError:
                self._socket.close()
                raise
        self._socket.settimeout(READ_TIMEOUT_S)

    def read(self, *, is_text: bool) -> bytes:
        """Return what has arrived, waiting for it at most the timeout; over UDP, one datagram.

        is_text: whether the pad sends lines. A datagram ends its last line, and a frame of several lines.
        """
        try:
            data = self._socket.recv(READ_BYTES)
        except TimeoutError:
            return b""
        if self.is_stream and not data:
            raise ConnectionResetError(errno.ECONNRESET, "closed")
        lines = data.rstrip(b"\r\n")
        if self.is_stream or not is_text or not lines.strip():
            return data
        return lines + (b"\n\n" if b"\n" in lines or b"\r" in lines else b"\n")

    def reset_input_buffer(self) -> None:
        while select.select([self._socket], [], [], 0)[0] and self._socket.recv(READ_BYTES):
            pass

    def __enter__(self) -> "NetworkPort":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()


Port: TypeAlias = serial.Serial | NetworkPort


def check_port(port: str, baud: int) -> None:
    """Raise SensorError if `port` is unusable, as far as can be seen.

    port: a device, tcp://host:port, or udp://address:port to listen at.
    Does not open it: opening restarts an Arduino, and disturbs whoever reads it already.
    """
    try:
        if "://" in port:
            address_of(port)
            return
        serial.Serial(None, baud)
        if not stat.S_ISCHR(os.stat(port).st_mode):
            raise OSError(errno.ENOTTY, "no device")
    except (OSError, ValueError) as error:
        raise sensor_error(port, error) from error


def open_port(port: str, baud: int) -> Port:
    """Open `port` for this program alone; raise SensorError when that fails."""
    try:
        if "://" in port:
            return NetworkPort(port)
        opened = serial.Serial(port, baud, timeout=READ_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError, termios.error) as error:
        raise sensor_error(port, error) from error
    # pyserial's lock keeps out only programs that lock, too; TIOCEXCL keeps out all. A pseudo-terminal would
    # stay closed to others if touchd were killed.
    if not os.path.realpath(port).startswith("/dev/pts/"):
        with contextlib.suppress(OSError):
            fcntl.ioctl(opened.fileno(), termios.TIOCEXCL)
    # Otherwise an FTDI adapter delays bytes by up to 16 ms; other ports lack the setting.
    with contextlib.suppress(AttributeError, NotImplementedError, OSError, ValueError):
        opened.set_low_latency_mode(True)
    return opened


def read_waiting(opened: Port, parser: FrameParser | None = None) -> bytes:
    """Return what has arrived, waiting at most 0.1 s for it; raise SensorError when it cannot be read.

    parser: of the pad's format; if that is text, a datagram ends its lines.
    """
    port = str(opened.port)
    try:
        if isinstance(opened, NetworkPort):
            return opened.read(is_text=parser is not None and parser.format.framing == "text")
        return _read(port, opened.fileno())
    except (OSError, termios.error) as error:
        raise _gone(port, error) from error


def discard_input(opened: Port) -> None:
    """Discard what has arrived; raise SensorError when the port is gone."""
    try:
        opened.reset_input_buffer()
    except (OSError, termios.error) as error:
        raise _gone(str(opened.port), error) from error


def reads_all(opened: Port) -> bool:
    """Whether one read returns all that has arrived, as on a serial port; over UDP it is a datagram."""
    return not isinstance(opened, NetworkPort) or opened.is_stream


def _gone(port: str, error: Exception) -> SensorError:
    """Return an error of reading an opened port: whatever its number, the device or the other end is gone."""
    number = errno.ECONNRESET if isinstance(error, ConnectionResetError) else errno.EIO
    return sensor_error(port, OSError(number, "gone"))


def _read(port: str, fd: int) -> bytes:
    """Return what has arrived at a port, waiting at most READ_TIMEOUT_S for it.

    pyserial's own read takes five system calls; two are enough.
    """
    if not select.select([fd], [], [], READ_TIMEOUT_S)[0]:
        return b""
    try:
        data = os.read(fd, READ_BYTES)
    except BlockingIOError:
        return b""
    if not data:
        # A port that is gone reads as empty too; poll() then reports a hang-up.
        hung_up = select.poll()
        hung_up.register(fd, 0)
        if hung_up.poll(0):
            raise OSError(errno.EIO, "hung up")
        raise SensorError("shared", f"{port} is read by another program too, which takes bytes; end it")
    return data
