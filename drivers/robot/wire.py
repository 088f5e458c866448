"""A session with a robot in QiMessaging, NAOqi's protocol, on any computer."""

import select
import socket
import struct
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from touchd.drivers import hosts
from touchd.drivers.errors import TouchdError, one_line
from touchd.drivers.robot.session import (
    ADVICE,
    STOPPING_LIMIT_S,
    Address,
    RobotLimits,
    RobotLost,
    RobotRefused,
    RobotSettings,
    address_of,
)
from touchd.drivers.robot.values import ValueFault, read, write

# Magic, id, bytes that follow, version, type, flags, service, object, action.
HEADER = struct.Struct("<4sIIHBBIII")
MAGIC = b"\x42\xde\xad\x42"
CALL, REPLY, ERROR, CANCELED = 1, 2, 3, 8
# A flag: the payload is a value with its own signature.
IS_DYNAMIC = 1
# The longest answer here lists a service's methods.
MOST_BYTES = 2_000_000
PIECE_BYTES = 65536
# Poll interval for the stop event while a call runs.
SLICE_S = 0.05
SEND_S = 0.5
# Notice a network that drops everything after 10 s, even while an action lasts minutes.
KEEPALIVE = {socket.TCP_KEEPIDLE: 4, socket.TCP_KEEPINTVL: 2, socket.TCP_KEEPCNT: 3}

# Service, object and action of each call.
AUTHENTICATE, FIND_SERVICE = (0, 0, 8), (1, 1, 100)
OBJECT, LIST_METHODS = 1, 2
CAPABILITIES = {
    "ClientServerSocket": True,
    "MessageFlags": False,
    "MetaObjectCache": False,
    "RemoteCancelableCalls": False,
}
AUTH_STATE, REFUSED, GOES_ON = "__qi_auth_state", 1, 2
MOST_ROUNDS, MOST_ENDPOINTS = 3, 8
# What is read of the answers; newer robots send more behind it.
SERVICE_INFO, METHODS = "(sIsI[s]s)", "({I(Issss[(ss)]s)})"


class Closed(RobotLost):
    """The connection was closed, or what answers is no robot. Other services may still be there."""


class Wait:
    """A wait with a limit, which is shorter once the daemon stops. what: what is waited for, in errors."""

    def __init__(self, what: str, limit_s: float, stopping: threading.Event) -> None:
        self.what = what
        self._limit_s = limit_s
        self._stopping = stopping
        self._begun_s = time.monotonic()

    def go_on(self) -> None:
        """Raise RobotLost when it is over."""
        waited_s = time.monotonic() - self._begun_s
        if waited_s >= self._limit_s or (self._stopping.is_set() and waited_s >= STOPPING_LIMIT_S):
            raise RobotLost(f"{self.what}: no answer within {waited_s:.1f} s")


class Connection:
    """A connection to one of the robot's processes; every method but `close` raises RobotLost."""

    def __init__(self, line: socket.socket, settings: RobotSettings, wait: Wait) -> None:
        """Begin TLS if the address says so, and log in."""
        line.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in KEEPALIVE.items():
            line.setsockopt(socket.IPPROTO_TCP, option, value)
        line.settimeout(SLICE_S)
        self._line = line
        self._number = 0
        self._ended = select.poll()
        self._ended.register(line, select.POLLRDHUP)
        try:
            self._log_in(settings, wait)
        except BaseException:
            self.close()
            raise

    def _log_in(self, settings: RobotSettings, wait: Wait) -> None:
        login = None
        try:
            if settings.address.scheme == "tcps":
                from touchd.drivers.robot.login import encrypted, read_login

                self._line = encrypted(self._line, settings.certificate, wait.go_on)
                login = read_login(settings)
            named = {"auth_user": login.user, "auth_token": login.token} if login else {}
            sent = write("{sm}", {**CAPABILITIES, **named})
            for _ in range(MOST_ROUNDS):
                answer = self.call(AUTHENTICATE, sent, "{sm}", wait)
                state = answer.get(AUTH_STATE) if isinstance(answer, dict) else None
                if state != GOES_ON:
                    break
            if state in (REFUSED, GOES_ON):
                raise Closed(f"{wait.what}: the login is refused")
        except RobotRefused as refused:
            # NAOqi 2.1 knows no login.
            if login:
                raise RobotLost(f"{refused}; {ADVICE}") from refused
        except TouchdError as error:
            raise RobotLost(f"{wait.what}: {error}") from error
        except Closed as error:
            raise RobotLost(f"{error}; {ADVICE}") from error
        except OSError as error:
            raise RobotLost(f"{wait.what}: {error.strerror or error}; {ADVICE}") from error

    def connected(self) -> bool:
        return self._line.fileno() != -1 and not self._ended.poll(0)

    def call(self, target: tuple[int, int, int], payload: bytes, returns: str, wait: Wait) -> object:
        """Return the answer, read by its signature; raises RobotRefused too."""
        self._number += 1
        header = HEADER.pack(MAGIC, self._number, len(payload), 0, CALL, 0, *target)
        try:
            self._line.settimeout(SEND_S)
            self._line.sendall(header + payload)
            self._line.settimeout(SLICE_S)
            kind, flags, answer = self._answer(wait)
        except OSError as error:
            self.close()
            raise Closed(f"{wait.what}: {error.strerror or error}") from error
        try:
            if kind == REPLY:
                return read("m" if flags & IS_DYNAMIC else returns, answer)
            why = str(read("m", answer)) if kind == ERROR else "canceled"
        except ValueFault as fault:
            raise Closed(f"{wait.what}: the answer cannot be read ({fault})") from fault
        raise RobotRefused(one_line(f"{wait.what}: {(why.splitlines() or ['refused'])[0]}"))

    def close(self) -> None:
        self._line.close()

    def _answer(self, wait: Wait) -> tuple[int, int, bytearray]:
        """Return kind, flags and payload of the answer to the last call; skip other messages."""
        while True:
            magic, number, size, _, kind, flags, *_ = HEADER.unpack(self._bytes(HEADER.size, wait))
            if magic != MAGIC or size > MOST_BYTES:
                self.close()
                raise Closed(f"{wait.what}: what answers there does not speak NAOqi's protocol")
            if number == self._number and kind in (REPLY, ERROR, CANCELED):
                return kind, flags, self._bytes(size, wait)
            while size > 0:
                size -= len(self._bytes(min(size, PIECE_BYTES), wait))

    def _bytes(self, size: int, wait: Wait) -> bytearray:
        data = bytearray()
        while len(data) < size:
            wait.go_on()
            with suppress(TimeoutError):
                piece = self._line.recv(min(size - len(data), PIECE_BYTES))
                if not piece:
                    raise Closed(f"{wait.what}: disconnected")
                data += piece
        return data


class Service(NamedTuple):
    """methods: action, name, and the signatures of the parameters and of the answer."""

    connection: Connection
    number: int
    methods: Sequence[tuple[int, str, str, str]]


class WireSession:
    """A RobotSession without a library or a thread of its own."""

    def __init__(self, settings: RobotSettings, limits: RobotLimits, stopping: threading.Event) -> None:
        self._settings = settings
        self._limits = limits
        self._stopping = stopping
        # The directory's first. Services in other processes have connections of their own, by endpoints.
        self._connections: dict[tuple[str, ...], Connection] = {}
        self._services: dict[str, Service] = {}
        self._peer: Any = ()

    def connect(self) -> None:
        _, host, port = self._settings.address
        try:
            line = hosts.connect(host, port, self._limits.connect_s, self._stopping)
            self._peer = line.family, line.getpeername()
        except OSError as error:
            raise RobotLost(f"connecting: {error.strerror or error}") from error
        self._connections[()] = Connection(line, self._settings, self._wait("connecting"))

    def connected(self) -> bool:
        return () in self._connections and self._connections[()].connected()

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        what = f"{service}.{method}"
        try:
            if service not in self._services:
                self._services[service] = self._find(service)
            connection, number, methods = self._services[service]
            action, payload, returns = _fitting(methods, what, arguments)
            return connection.call((number, OBJECT, action), payload, returns, self._wait(what, limit_s))
        except (RobotRefused, Closed) as error:
            # The service may have ended; once it is back, it has another number.
            self._services.pop(service, None)
            if isinstance(error, Closed) and self.connected():
                raise RobotRefused(str(error)) from error
            raise

    def close(self) -> None:
        for connection in self._connections.values():
            connection.close()

    def _wait(self, what: str, limit_s: float | None = None) -> Wait:
        return Wait(what, self._limits.connect_s if limit_s is None else limit_s, self._stopping)

    def _find(self, service: str) -> Service:
        """Return a service and its methods; raises RobotLost or RobotRefused."""
        wait = self._wait(f"looking for {service}")
        directory = self._connections[()]
        found: Any = directory.call(FIND_SERVICE, write("s", service), SERVICE_INFO, wait)
        _, number, _, _, endpoints, _ = found
        connection = self._connection_to(tuple(endpoints), wait)
        listed: Any = connection.call((number, OBJECT, LIST_METHODS), write("I", 0), METHODS, wait)
        methods = [(action, name, takes, gives) for action, (_, gives, name, takes, *_) in listed[0].items()]
        return Service(connection, number, methods)

    def _connection_to(self, endpoints: tuple[str, ...], wait: Wait) -> Connection:
        """Return the connection to a service: the directory's, or one to the service's own process."""
        here, (family, peer) = self._settings.address, self._peer
        offered: list[Address] = []
        for endpoint in endpoints[:MOST_ENDPOINTS]:
            with suppress(ValueError):
                offered.append(address_of(endpoint))
        offered = [one for one in offered if one.scheme == here.scheme]
        if not offered or any(one.port == here.port for one in offered):
            return self._connections[()]
        if endpoints not in self._connections or not self._connections[endpoints].connected():
            # First at the address by which the robot was reached; it also names those in other networks.
            near: list[hosts.Address] = [(family, (peer[0], one.port, *peer[2:])) for one in offered]
            far = [(one.family, (one.host, one.port)) for one in offered if one.family and not one.is_here]
            try:
                line = hosts.dial(dict.fromkeys(near + far), self._limits.connect_s, self._stopping)
                self._connections[endpoints] = Connection(line, self._settings, wait)
            except (OSError, RobotLost) as error:
                raise RobotRefused(f"{wait.what}: {getattr(error, 'strerror', None) or error}") from error
        return self._connections[endpoints]


def _fitting(
    methods: Sequence[tuple[int, str, str, str]], what: str, arguments: Sequence[object]
) -> tuple[int, bytes, str]:
    """Return the first method that takes these arguments, they in bytes, and what it returns."""
    for action, name, takes, gives in methods:
        if name == what.partition(".")[2]:
            # A robot's method may have kinds of parameters that are unknown here.
            with suppress(ValueFault):
                return action, write(takes, arguments), gives
    raise RobotRefused(f"{what}: there is none that takes these arguments")
