"""The port of a pad, serial or on the network: opening it, reading it, and why that fails, in one line."""

import contextlib
import errno
import fcntl
import os
import re
import select
import stat
import termios
import typing
from typing import TypeAlias, Union

import serial

from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.why_not import SensorError as SensorError
from touchd.drivers.pad.why_not import programs_at, shared, why_not_opened, why_not_read

READ_TIMEOUT_S = 0.1
READ_BYTES = 65536

if typing.TYPE_CHECKING:
    from touchd.drivers.pad.network import NetworkPort

Line: TypeAlias = Union[serial.Serial, "NetworkPort"]


class NothingReadError(Exception):
    """Bytes had arrived at a port that is still there, and another program read them first."""


def at_baud(port: str, baud: int) -> str:
    """Return " at 512000 baud", for people, or nothing where the port is an address and has none."""
    return "" if "://" in port else f" at {baud} baud"


def check_port(port: str, baud: int) -> None:
    """Raise SensorError if `port` is unusable, as far as can be seen.

    port: a device, tcp://host:port, udp://address:port to listen at, or any `serial_for_url` address.

    Does not open it: opening restarts an Arduino, and disturbs whoever reads it already.
    """
    try:
        if "://" in port:
            from touchd.drivers.pad.network import address_of

            if address_of(port):
                return
        serial.serial_for_url(port, baudrate=baud, do_not_open=True)
        if "://" in port:
            return
        if not stat.S_ISCHR(os.stat(port).st_mode):
            raise OSError(errno.ENOTTY, "no device")
        if not os.access(port, os.R_OK | os.W_OK, effective_ids=True):
            raise PermissionError(errno.EACCES, "permission denied")
    except (OSError, ValueError, re.error) as error:
        raise why_not_opened(port, error) from error


def open_port(port: str, baud: int) -> Line:
    """Open `port` for this program alone; raise SensorError when that fails."""
    try:
        if "://" in port:
            from touchd.drivers.pad.network import NetworkPort, address_of

            if address := address_of(port):
                return NetworkPort(port, *address, READ_TIMEOUT_S)
        opened = serial.serial_for_url(port, baudrate=baud, timeout=READ_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError, LookupError, re.error, termios.error) as error:
        raise why_not_opened(port, error) from error
    # The lock above keeps out only programs that lock, too. A pseudo-terminal is left out, because it would
    # stay closed to others if touchd were killed.
    if isinstance(opened, serial.Serial) and not os.path.realpath(port).startswith("/dev/pts/"):
        with contextlib.suppress(OSError):
            fcntl.ioctl(opened.fileno(), termios.TIOCEXCL)
    # Otherwise an FTDI adapter delays bytes by up to 16 ms; other ports lack the setting.
    with contextlib.suppress(AttributeError, NotImplementedError, OSError, ValueError):
        opened.set_low_latency_mode(True)
    return opened


def read_waiting(opened: Line, parser: FrameParser) -> bytes:
    """Return what has arrived, waiting at most 0.1 s for it; raise SensorError when it cannot be read."""
    try:
        if not isinstance(opened, serial.SerialBase):
            return opened.read(is_text=parser.format.framing == "text")
        # pyserial's own read takes five system calls; two are enough.
        if type(opened) is serial.Serial:
            return _read(opened.fileno())
        first = opened.read(1)
        return first + opened.read(opened.in_waiting) if first else b""
    except NothingReadError as error:
        raise shared(str(opened.port), programs_at(str(opened.port))) from error
    except (OSError, termios.error) as error:
        raise why_not_read(str(opened.port), error) from error


def forget_waiting(opened: Line) -> None:
    """Discard what has arrived; raise SensorError when the port is gone."""
    try:
        opened.reset_input_buffer()
    except (OSError, termios.error) as error:
        raise why_not_read(str(opened.port), error) from error


def reads_all(opened: Line) -> bool:
    """Whether one read returns all that has arrived, as on a serial port; over UDP it is a datagram."""
    return type(opened) is serial.Serial or (not isinstance(opened, serial.SerialBase) and opened.is_stream)


def _read(fd: int) -> bytes:
    """Return what has arrived at a port, waiting at most READ_TIMEOUT_S for it."""
    if not select.select([fd], [], [], READ_TIMEOUT_S)[0]:
        return b""
    try:
        data = os.read(fd, READ_BYTES)
    except BlockingIOError:
        return b""
    if not data:
        # A port that is gone is readable, too, and says so.
        hung_up = select.poll()
        hung_up.register(fd, 0)
        raise OSError(errno.EIO, "hung up") if hung_up.poll(0) else NothingReadError
    return data
