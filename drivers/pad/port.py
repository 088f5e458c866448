"""The port of a pad, serial or on the network: opening it, reading it, and why that fails, in one line."""

import contextlib
import errno
import fcntl
import logging
import os
import re
import select
import socket
import stat
import termios
import time
from typing import Any, TypeAlias

import serial

from touchd.drivers.errors import TouchdError
from touchd.drivers.pad.parser import FrameParser

log = logging.getLogger(__name__)

READ_TIMEOUT_S = 0.1
READ_BYTES = 65536

NOT_THERE = {errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.EIO, errno.ECONNREFUSED, errno.EHOSTUNREACH}
NOT_ALLOWED = {errno.EACCES, errno.EPERM}
# EAGAIN is what pyserial's lock reports when another program that locks, as touchd does, has the port open.
IN_USE = {errno.EBUSY, errno.EAGAIN, errno.EADDRINUSE}
CONNECT_S = 3.0
# Over UDP another board is read once the one that is read has sent no frame for GONE_S; one of which no frame
# has come yet, for TURN_S.
GONE_S, TURN_S = 2.0, 0.5
ADDRESS = re.compile(r"(tcp|udp)://(\[[^\]]+\]|[^\s/:]+):(\d{1,5})")


class SensorError(TouchdError):
    """The port cannot be used; the message says why and what to do.

    kind: "missing", "denied", "busy" or "unusable".
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class NetworkPort:
    """tcp://host:port connects to the pad; udp://address:port listens there for what the pad sends."""

    def __init__(self, port: str, timeout_s: float) -> None:
        self.port = port
        self.baudrate = 0
        match = ADDRESS.fullmatch(port)
        assert match is not None
        where = (match[2].strip("[]"), int(match[3]))
        if match[1] == "tcp":
            self._socket = socket.create_connection(where, CONNECT_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        else:
            family = socket.AF_INET6 if ":" in where[0] else socket.AF_INET
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            try:
                self._socket.bind(where)
            except OSError:
                self._socket.close()
                raise
        self.is_stream = match[1] == "tcp"
        self._sender: Any = None
        self._until_s = 0.0
        self._sends_frames = False
        self._has_warned = False
        self._socket.settimeout(timeout_s)

    def read(self) -> bytes:
        """Return what has arrived, waiting for it at most the timeout; over UDP, one datagram."""
        try:
            data, sender = self._socket.recvfrom(READ_BYTES)
        except TimeoutError:
            return b""
        if not data and self.is_stream:
            raise ConnectionResetError("the pad closed the connection")
        return data if self.is_stream or self._follows(sender) else b""

    def keep_sender(self) -> None:
        """Note that what was read last completed a frame: its sender is the pad."""
        self._sends_frames = True
        self._until_s = time.monotonic() + GONE_S

    def _follows(self, sender: Any) -> bool:
        """Whether a datagram comes from the board that is read: who sends frames, or else each in turn."""
        is_other = self._sender is None or sender[0] != self._sender[0]
        if is_other and time.monotonic() < self._until_s:
            if self._sends_frames and not self._has_warned:
                self._has_warned = True
                log.warning(
                    "%s: %s sends there too; only %s is read: give each board a port of its own",
                    self.port,
                    sender[0],
                    self._sender[0],
                )
            return False
        if is_other:
            self._sends_frames = False
            self._until_s = time.monotonic() + TURN_S
        self._sender = sender
        return True

    def write(self, data: bytes) -> None:
        """Send to the pad; over UDP, to whoever sent last."""
        if self.is_stream:
            self._socket.sendall(data)
        elif self._sender is not None:
            self._socket.sendto(data, self._sender)

    def reset_input_buffer(self) -> None:
        while select.select([self._socket], [], [], 0)[0] and self._socket.recv(READ_BYTES):
            pass

    def __enter__(self) -> "NetworkPort":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()


Line: TypeAlias = serial.Serial | NetworkPort


def at_baud(port: str, baud: int) -> str:
    """Return " at 512000 baud", for people, or nothing where the port is an address and has none."""
    return "" if "://" in port else f" at {baud} baud"


def check_port(port: str, baud: int) -> None:
    """Raise SensorError when `port` can be seen to be unusable.

    port: a device, tcp://host:port, udp://address:port to listen at, or any `serial_for_url` address.

    Does not open it: opening restarts an Arduino, and disturbs whoever reads it already.
    """
    try:
        if _is_network(port):
            return
        serial.serial_for_url(port, baudrate=baud, do_not_open=True)
        if "://" in port:
            return
        if not stat.S_ISCHR(os.stat(port).st_mode):
            raise OSError(errno.ENOTTY, "no device")
        if not os.access(port, os.R_OK | os.W_OK, effective_ids=True):
            raise PermissionError(errno.EACCES, "permission denied")
    except (OSError, ValueError) as error:
        raise _explained(port, error) from error


def open_port(port: str, baud: int) -> Line:
    """Open `port` for this program alone; raise SensorError when that fails."""
    try:
        if _is_network(port):
            return NetworkPort(port, READ_TIMEOUT_S)
        opened = serial.serial_for_url(port, baudrate=baud, timeout=READ_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError, termios.error) as error:
        raise _explained(port, error) from error
    # The lock above keeps only those programs out that ask for it too. A pseudo-terminal would stay closed to
    # others after touchd was killed.
    if isinstance(opened, serial.Serial) and not os.path.realpath(port).startswith("/dev/pts/"):
        with contextlib.suppress(OSError):
            fcntl.ioctl(opened.fileno(), termios.TIOCEXCL)
    # Otherwise an FTDI adapter delays bytes by up to 16 ms; other ports lack the setting.
    with contextlib.suppress(AttributeError, NotImplementedError, OSError, ValueError):
        opened.set_low_latency_mode(True)
    return opened


def read_waiting(opened: Line, parser: FrameParser) -> bytes:
    """Return what has arrived, waiting at most 0.1 s for it; raise SensorError when the port is gone.

    A pad that only answers is asked when its parser says so.
    """
    try:
        if parser.poll:
            _ask(opened, parser)
        if isinstance(opened, NetworkPort):
            data = opened.read()
            is_text = parser.format.framing == "text"
            return data if opened.is_stream or not is_text else _ended_lines(data)
        # pyserial's own reading takes five system calls where two do.
        if type(opened) is serial.Serial:
            return _read(opened.fileno())
        first = opened.read(1)
        return first + opened.read(opened.in_waiting) if first else b""
    except (OSError, termios.error) as error:
        raise SensorError("missing", f"{opened.port} went away: unplugged or switched off?") from error


def _is_network(port: str) -> bool:
    """Whether this is an address of a pad on the network; raises ValueError for one that is malformed."""
    if not port.startswith(("tcp://", "udp://")):
        if port.startswith("rfc2217://"):
            # pyserial reads it into a queue that has no limit.
            raise ValueError("not supported; set the server to raw TCP and write tcp://HOST:PORT")
        if re.fullmatch(r"socket://[^:]*", port):
            raise ValueError("gives no port; write it as in socket://192.168.1.20:4000")
        return False
    match = ADDRESS.fullmatch(port)
    if match is None or int(match[3]) > 65535:
        raise ValueError("not an address such as tcp://192.168.1.20:4000 or udp://0.0.0.0:4000")
    return True


def _read(fd: int) -> bytes:
    """Return what has arrived at a port, waiting at most READ_TIMEOUT_S for it."""
    if not select.select([fd], [], [], READ_TIMEOUT_S)[0]:
        return b""
    try:
        data = os.read(fd, READ_BYTES)
    except BlockingIOError:
        return b""
    if not data:
        raise OSError(errno.EIO, "readable, but nothing to read")
    return data


def _ask(opened: Line, parser: FrameParser) -> None:
    wait_s = parser.ask_in_s(time.monotonic())
    if wait_s > READ_TIMEOUT_S:
        return
    time.sleep(wait_s)
    # A late reply to the previous poll must not become half of the next.
    opened.reset_input_buffer()
    parser.ask(time.monotonic())
    opened.write(parser.poll)


def _explained(port: str, error: Exception) -> SensorError:
    number = error.errno if isinstance(error, OSError) else None
    if number in NOT_THERE:
        question = "is the pad's board switched on, and in this network?"
        if "://" not in port:
            question = "is the pad plugged in and switched on?"
        return SensorError("missing", f"{port} is not there: {question}")
    if number in NOT_ALLOWED:
        return SensorError(
            "denied",
            f"no permission to open {port}: add the user to the group dialout (sudo usermod -aG dialout "
            "$USER, then log in again) or install the udev rule systemd/99-touchd.rules",
        )
    if number in IN_USE:
        hint = str(error) if "://" in port else f"fuser {port} shows which"
        return SensorError("busy", f"{port} is busy: another program reads it ({hint})")
    if "://" not in port and os.path.exists(port) and not stat.S_ISCHR(os.stat(port).st_mode):
        return SensorError("unusable", f"{port} is not a serial port: name a device like /dev/ttyACM0")
    return SensorError("unusable", f"{port} cannot be opened: {error}")


def _ended_lines(datagram: bytes) -> bytes:
    """Return a datagram of text with its last line ended, and with a blank line after several lines."""
    if not datagram.strip():
        return b""
    lines = datagram.rstrip(b"\r\n")
    return lines + (b"\n\n" if b"\n" in lines or b"\r" in lines else b"\n")
