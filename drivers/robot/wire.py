"""A session with a robot by QiMessaging, NAOqi's protocol, on any computer."""

import re
import select
import socket
import struct
import threading
from contextlib import suppress
from typing import Any

from touchd.drivers import hosts
from touchd.drivers.robot.session import GoOn, RobotLimits, RobotLost, RobotRefused, RobotSettings, waiting
from touchd.drivers.robot.values import read, write

# Magic, id, size of the payload, version, type, flags, service, object, action.
HEADER = struct.Struct("<4sIIHBBIII")
MAGIC = b"\x42\xde\xad\x42"
CALL, REPLY, ERROR = 1, 2, 3
# Ten times the longest answer, which lists a service's methods. Decoded, it takes ten times the memory.
MOST_BYTES = 400_000

# Service, object and action of each call.
AUTHENTICATE, FIND_SERVICE = (0, 0, 8), (1, 1, 100)
OBJECT, LIST_METHODS = 1, 2
NO_CAPABILITIES = dict.fromkeys(("MessageFlags", "MetaObjectCache", "RemoteCancelableCalls"), False)
CAPABILITIES = {"ClientServerSocket": True, **NO_CAPABILITIES}
AUTH_STATE, DONE = "__qi_auth_state", 3
# The part of the answers that is read; newer robots append more.
SERVICE_INFO, METHODS = "(sIsI[s]s)", "({I(Issss[(ss)]s)})"


class WireSession:
    """A RobotSession with one of the robot's processes, without a library or a thread of its own.

    port: of a process other than that of robot.url, whose directory knows the process of each service.
    """

    def __init__(
        self, settings: RobotSettings, limits: RobotLimits, stopping: threading.Event, port: int | None = None
    ) -> None:
        self._settings, self._limits, self._stopping = settings, limits, stopping
        self._scheme, self._host, main = settings.address
        self._port, self._number = port or main, 0
        self._line, self._ended = socket.socket(), select.poll()
        # Other processes by port; and of each service its process, its number there and its methods.
        self._processes: dict[int, WireSession] = {}
        self._services: dict[str, tuple[WireSession, int, dict[int, Any]]] = {}

    def connect(self) -> None:
        with waiting("connecting", self._limits.connect_s, self._stopping) as go_on:
            self.use(hosts.connect(self._host, self._port, self._limits.connect_s, self._stopping), go_on)

    def use(self, line: socket.socket, go_on: GoOn) -> None:
        """Log in over a connection, in place of the unconnected socket, with TLS if the address says so."""
        self._line.close()
        self._line = line
        line.settimeout(hosts.SLICE_S)
        self._ended.register(line, select.POLLRDHUP)
        if self._scheme == "tcps":
            self._line, shown = encrypted(line, go_on)
            if self._settings.pinned not in (None, shown.replace(":", "")):
                raise ConnectionError(f"not the robot of robot.certificate: this one's is {shown}")
        login = {f"auth_{key}": value for key, value in self._settings.login().items()}
        try:
            answer = self._ask(AUTHENTICATE, write("{sm}", {**CAPABILITIES, **login}), "{sm}", go_on)
        except RobotRefused:
            # NAOqi 2.1 has no login.
            if login:
                raise
        else:
            if answer.get(AUTH_STATE, DONE) != DONE:
                raise ConnectionError("the login is refused")

    def connected(self) -> bool:
        return not self._ended.poll(0)

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        try:
            if service not in self._services or not self._services[service][0].connected():
                with waiting(f"looking for {service}", self._limits.connect_s, self._stopping) as go_on:
                    self._services[service] = self._find(service, go_on)
            process, number, methods = self._services[service]
            with waiting(f"{service}.{method}", limit_s, self._stopping) as go_on:
                action, payload, gives = _fitting(methods, method, arguments)
                return process._ask((number, OBJECT, action), payload, gives, go_on)
        except RobotRefused:
            # The service may have restarted, and has another number then.
            self._services.pop(service, None)
            raise

    def close(self) -> None:
        for process in self._processes.values():
            process.close()
        self._line.close()

    def _find(self, service: str, go_on: GoOn) -> tuple["WireSession", int, dict[int, Any]]:
        """Return a service's process, its number there and its methods."""
        _, number, _, _, endpoints, _ = self._ask(FIND_SERVICE, write("s", service), SERVICE_INFO, go_on)
        # Ignore the hosts: they may be the robot's addresses in other networks.
        ports = re.findall(rf"^{self._scheme}://.*:(\d{{1,5}})$", "\n".join(endpoints), re.MULTILINE)
        process = self if not ports or str(self._port) in ports else self._process_at(int(ports[0]))
        (methods,) = process._ask((number, OBJECT, LIST_METHODS), write("I", 0), METHODS, go_on)
        return process, number, methods

    def _process_at(self, port: int) -> "WireSession":
        process = self._processes.get(port)
        if process is None or not process.connected():
            process = WireSession(self._settings, self._limits, self._stopping, port)
            try:
                process.connect()
            except (RobotLost, RobotRefused) as error:
                process.close()
                raise RobotRefused(str(error)) from error
            self._processes[port] = process
        return process

    def _ask(self, target: tuple[int, int, int], payload: bytes, returns: str, go_on: GoOn) -> Any:
        """Call an action; return the answer, read by its signature. Raises OSError or RobotRefused."""
        self._number += 1
        self._line.sendall(HEADER.pack(MAGIC, self._number, len(payload), 0, CALL, 0, *target) + payload)
        kind, answer = self._answer(go_on)
        try:
            if kind == REPLY:
                return read(returns, answer)
            why = str(read("m", answer))
        except ValueError as error:
            why = f"the answer cannot be read ({error})"
        raise RobotRefused(why)

    def _answer(self, go_on: GoOn) -> tuple[int, bytearray]:
        """Return kind and payload of the answer to the last call; skip other messages."""
        while True:
            magic, number, size, _, kind, *_ = HEADER.unpack(self._received(HEADER.size, go_on))
            if magic != MAGIC or size > MOST_BYTES:
                raise ConnectionError("what answers there does not speak NAOqi's protocol")
            payload = self._received(size, go_on)
            if number == self._number and kind in (REPLY, ERROR):
                return kind, payload

    def _received(self, size: int, go_on: GoOn) -> bytearray:
        data = bytearray()
        while len(data) < size:
            go_on()
            with suppress(TimeoutError):
                piece = self._line.recv(size - len(data))
                if not piece:
                    raise ConnectionError("disconnected")
                data += piece
        return data


def encrypted(line: socket.socket, go_on: GoOn) -> tuple[socket.socket, str]:
    """Begin TLS; return the connection and its certificate's fingerprint, as in robot.certificate."""
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


def _fitting(methods: dict[int, Any], method: str, arguments: tuple[object, ...]) -> tuple[int, bytes, str]:
    """Return the first method that accepts the arguments, with these encoded and its answer's signature."""
    for action, (_, gives, name, takes, *_) in methods.items():
        if name == method:
            # Try another method of this name if the arguments do not fit, or a parameter's type is unknown.
            with suppress(ValueError, struct.error):
                return action, write(takes, arguments), gives
    raise RobotRefused("there is none that takes these arguments")
