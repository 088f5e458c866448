"""A session with a robot in QiMessaging, NAOqi's protocol, on any computer."""

import re
import select
import socket
import struct
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from touchd.drivers import hosts
from touchd.drivers.errors import MAX_LINE_BYTES, TouchdError, one_line, reason
from touchd.drivers.robot.session import ADVICE, RobotLimits, RobotLost, RobotRefused, RobotSettings, Wait
from touchd.drivers.robot.values import read, write

# Magic, id, bytes that follow, version, type, flags, service, object, action.
HEADER = struct.Struct("<4sIIHBBIII")
MAGIC = b"\x42\xde\xad\x42"
CALL, REPLY, ERROR = 1, 2, 3
# Ten times the longest answer, which lists a service's methods. What is read of it takes ten times as much.
MOST_BYTES = 400_000

# Service, object and action of each call.
AUTHENTICATE, FIND_SERVICE = (0, 0, 8), (1, 1, 100)
OBJECT, LIST_METHODS = 1, 2
NO_CAPABILITIES = dict.fromkeys(("MessageFlags", "MetaObjectCache", "RemoteCancelableCalls"), False)
CAPABILITIES = {"ClientServerSocket": True, **NO_CAPABILITIES}
AUTH_STATE, DONE = "__qi_auth_state", 3
# What is read of the answers; newer robots send more behind it.
SERVICE_INFO, METHODS = "(sIsI[s]s)", "({I(Issss[(ss)]s)})"


class Connection:
    """A connection to one of the robot's processes, with TLS if the address says so, and logged in.

    Making it, and every call, raises RobotLost.
    """

    def __init__(self, line: socket.socket, settings: RobotSettings, wait: Wait) -> None:
        line.settimeout(hosts.SLICE_S)
        self._line = line
        self._number = 0
        self._ended = select.poll()
        self._ended.register(line, select.POLLRDHUP)
        try:
            self._log_in(settings, wait)
        except (OSError, TouchdError, RobotLost, RobotRefused) as error:
            self.close()
            raise RobotLost(f"{reason(error)}; {ADVICE}") from error

    def _log_in(self, settings: RobotSettings, wait: Wait) -> None:
        login: dict[str, str] = {}
        scheme, _, _ = settings.address
        if scheme == "tcps":
            self._line, shown = encrypted(self._line, wait.go_on)
            # openssl writes capitals, and colons between the bytes.
            if settings.pinned and settings.pinned.replace(":", "").lower() != shown.replace(":", ""):
                raise RobotLost(f"{wait.what}: not the robot of robot.certificate: this one's is {shown}")
        if settings.user is not None:
            login = {"auth_user": settings.user, "auth_token": settings.read_token()}
        try:
            answer = self.call(AUTHENTICATE, write("{sm}", {**CAPABILITIES, **login}), "{sm}", wait)
        except RobotRefused:
            # NAOqi 2.1 knows no login.
            if login:
                raise
        else:
            if answer.get(AUTH_STATE, DONE) != DONE:
                raise RobotLost(f"{wait.what}: the login is refused")

    def connected(self) -> bool:
        return self._line.fileno() != -1 and not self._ended.poll(0)

    def call(self, target: tuple[int, int, int], payload: bytes, returns: str, wait: Wait) -> Any:
        """Return the answer, read by its signature; raises RobotRefused too."""
        self._number += 1
        header = HEADER.pack(MAGIC, self._number, len(payload), 0, CALL, 0, *target)
        try:
            self._line.sendall(header + payload)
            kind, answer = self._answer(wait)
        except OSError as error:
            self.close()
            raise RobotLost(f"{wait.what}: {reason(error)}") from error
        try:
            if kind == REPLY:
                return read(returns, answer)
            why = str(read("m", answer))[:MAX_LINE_BYTES]
        except ValueError as error:
            why = f"the answer cannot be read ({error})"
        raise RobotRefused(one_line(" ".join(f"{wait.what}: {why}".split())))

    def close(self) -> None:
        self._line.close()

    def _answer(self, wait: Wait) -> tuple[int, bytearray]:
        """Return kind and payload of the answer to the last call; skip other messages."""
        while True:
            magic, number, size, _, kind, *_ = HEADER.unpack(self._received(HEADER.size, wait))
            if magic != MAGIC or size > MOST_BYTES:
                raise ConnectionError("what answers there does not speak NAOqi's protocol")
            payload = self._received(size, wait)
            if number == self._number and kind in (REPLY, ERROR):
                return kind, payload

    def _received(self, size: int, wait: Wait) -> bytearray:
        data = bytearray()
        while len(data) < size:
            wait.go_on()
            with suppress(TimeoutError):
                piece = self._line.recv(size - len(data))
                if not piece:
                    raise ConnectionError("disconnected")
                data += piece
        return data


def encrypted(line: socket.socket, go_on: Callable[[], None]) -> tuple[socket.socket, str]:
    """Begin TLS on a connection; return it and its certificate's fingerprint, as in robot.certificate.

    go_on: called whenever the connection's timeout is over, to raise an error or to continue. Raises OSError.
    """
    # OpenSSL takes megabytes, which a robot without TLS does not need.
    import hashlib
    import ssl

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    # A robot signs its certificate itself, so only the fingerprint proves anything.
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    tls = context.wrap_socket(line, do_handshake_on_connect=False)
    while True:
        with suppress(TimeoutError):
            tls.do_handshake()
            return tls, f"sha256:{hashlib.sha256(tls.getpeercert(binary_form=True) or b'').hexdigest()}"
        go_on()


class WireSession:
    """A RobotSession without a library or a thread of its own."""

    def __init__(self, settings: RobotSettings, limits: RobotLimits, stopping: threading.Event) -> None:
        self._settings, self._limits, self._stopping = settings, limits, stopping
        self._scheme, self._host, self._port = settings.address
        # By port: the directory's, and those to services in other processes.
        self._connections: dict[int, Connection] = {}
        self._services: dict[str, tuple[Connection, int, dict[int, Any]]] = {}

    def connect(self) -> None:
        self._connection_to(self._port, Wait("connecting", self._limits.connect_s, self._stopping))

    def connected(self) -> bool:
        return self._connections[self._port].connected()

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        what = f"{service}.{method}"
        try:
            if service not in self._services or not self._services[service][0].connected():
                self._services[service] = self._find(service)
            connection, number, methods = self._services[service]
            action, payload, gives = _fitting(methods, what, arguments)
            wait = Wait(what, limit_s, self._stopping)
            return connection.call((number, OBJECT, action), payload, gives, wait)
        except RobotRefused:
            # The service may have ended; once it is back, it has another number.
            self._services.pop(service, None)
            raise

    def close(self) -> None:
        for connection in self._connections.values():
            connection.close()

    def _find(self, service: str) -> tuple[Connection, int, dict[int, Any]]:
        """Return a service's connection, number and methods; raises RobotLost or RobotRefused."""
        wait = Wait(f"looking for {service}", self._limits.connect_s, self._stopping)
        connection = self._connections[self._port]
        _, number, _, _, endpoints, _ = connection.call(FIND_SERVICE, write("s", service), SERVICE_INFO, wait)
        found = (re.fullmatch(rf"{self._scheme}://.*:(\d{{1,5}})", endpoint) for endpoint in endpoints)
        offered = [int(endpoint[1]) for endpoint in found if endpoint]
        if offered and self._port not in offered:
            try:
                connection = self._connection_to(offered[0], wait)
            except RobotLost as error:
                raise RobotRefused(str(error)) from error
        (methods,) = connection.call((number, OBJECT, LIST_METHODS), write("I", 0), METHODS, wait)
        return connection, number, methods

    def _connection_to(self, port: int, wait: Wait) -> Connection:
        """Return the connection to a port of the robot; raises RobotLost."""
        connection = self._connections.get(port)
        if connection is None or not connection.connected():
            try:
                # The configured host: an endpoint may name the robot's address in another network.
                line = hosts.connect(self._host, port, self._limits.connect_s, self._stopping)
            except (OSError, OverflowError) as error:
                raise RobotLost(f"{wait.what}: {reason(error)}") from error
            connection = self._connections[port] = Connection(line, self._settings, wait)
        return connection


def _fitting(methods: dict[int, Any], what: str, arguments: tuple[object, ...]) -> tuple[int, bytes, str]:
    """Return the first method that takes these arguments, they in bytes, and what it returns."""
    for action, (_, gives, name, takes, *_) in methods.items():
        if name == what.partition(".")[2]:
            # A robot's method may have kinds of parameters that are unknown here.
            with suppress(ValueError, struct.error):
                return action, write(takes, arguments), gives
    raise RobotRefused(f"{what}: there is none that takes these arguments")
