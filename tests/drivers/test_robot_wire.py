"""The robot's protocol: what its server sent, and what no robot should send."""

import socket
import struct
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rigs.attackers import Attack, never_answers, server
from rigs.sockets import free_port
from rigs.wait import AT_ONCE_S

from touchd.drivers.robot.session import (
    RobotLimits,
    RobotLost,
    RobotRefused,
    RobotSession,
    RobotSettings,
)
from touchd.drivers.robot.values import write
from touchd.drivers.robot.wire import (
    AUTH_STATE,
    AUTHENTICATE,
    CALL,
    ERROR,
    HEADER,
    MAGIC,
    MOST_BYTES,
    REPLY,
    WireSession,
)

EXCHANGE = Path(__file__).parents[1] / "recordings/robot-qi-3.1.5.txt"
MOST_MEMORY_BYTES = 4_000_000
LIMITS = RobotLimits(connect_s=0.3)
NAO = RobotSettings(url="tcp://nao:9559")
Sent = tuple[int, tuple[int, int, int], bytes]
"""A message from the session: its id, its target and its payload."""
Script = Callable[[Sent], bytes]
"""Returns the bytes that answer a message."""


def said(kind: int, number: int, payload: bytes, *, magic: bytes = MAGIC) -> bytes:
    return HEADER.pack(magic, number, len(payload), 0, kind, 0, 1, 1, 100) + payload


@contextmanager
def session_with(attack: Attack, limits: RobotLimits = LIMITS) -> Iterator[RobotSession]:
    """A session, not yet connected, with a peer that does what an attack says."""
    port = free_port()
    reached = RobotSettings(url=f"tcp://127.0.0.1:{port}")
    with server(port, attack), closing(WireSession(reached, limits, threading.Event())) as session:
        yield session


def by(script: Script) -> Attack:
    """Answer each message by a script."""

    def answer(client: socket.socket, _goes_on: Callable[[], bool]) -> None:
        client.settimeout(10.0)
        while header := client.recv(HEADER.size, socket.MSG_WAITALL):
            _, number, size, _, _, _, *target = HEADER.unpack(header)
            payload = client.recv(size, socket.MSG_WAITALL) if size else b""
            client.sendall(script((number, tuple(target), payload)))  # type: ignore[arg-type]

    return answer


def robot_of(script: Script, limits: RobotLimits = LIMITS) -> Any:
    return session_with(by(script), limits)


def logged_in(number: int, state: int = 3) -> bytes:
    return said(REPLY, number, write("{sm}", {AUTH_STATE: state}))


def after_login(script: Script) -> Script:
    return lambda sent: logged_in(sent[0]) if sent[1] == AUTHENTICATE else script(sent)


def test_a_recorded_robot_is_understood_message_by_message() -> None:
    wrong: list[bytes] = []

    def play(client: socket.socket, _goes_on: Callable[[], bool]) -> None:
        port = str(client.getsockname()[1]).encode().hex()
        for line in EXCHANGE.read_text().splitlines()[1:]:
            who, text = line.replace("PORT", port).split()
            message = bytes.fromhex(text)
            if who == "robot":
                client.sendall(message)
            elif (sent := client.recv(len(message), socket.MSG_WAITALL)) != message:
                wrong.append(sent)

    with session_with(play) as robot:
        robot.connect()
        assert robot.call("ALSystem", "systemVersion", limit_s=5) == "2.8.7.4"
        detail = ["stroke", 0.75, [1_790_000_000, 250_000], "early", 7, 12]
        robot.call("ALMemory", "raiseEvent", "TouchGesture/Detail", detail, limit_s=5)
        assert robot.call("ALMemory", "getData", "TouchGesture/Detail", limit_s=5) == detail
        with pytest.raises(RobotRefused, match="no data named TouchGesture/Nothing"):
            robot.call("ALMemory", "getData", "TouchGesture/Nothing", limit_s=5)
    assert wrong == []


@pytest.mark.parametrize(
    "before",
    [
        pytest.param(b"", id="nothing"),
        pytest.param(said(6, 1, write("{sm}", {"MessageFlags": True})), id="its capabilities"),
        pytest.param(said(5, 77, b"\xff" * 1000), id="an event"),
        pytest.param(said(CALL, 2, b""), id="a call with our number"),
        pytest.param(said(REPLY, 99, b"late"), id="a late answer"),
        pytest.param(said(4, 0, bytes(MOST_BYTES)), id="the longest message"),
        pytest.param(said(5, 1, b"") * 1000, id="a thousand events"),
        pytest.param(said(ERROR, 1, write("m", "no such action")), id="no login, as NAOqi 2.1"),
    ],
)
def test_a_robot_is_reached_whatever_it_sends_before_its_answer(before: bytes) -> None:
    with robot_of(lambda sent: before + logged_in(sent[0])) as robot:
        robot.connect()
        assert robot.connected()


NO_ROBOT = "does not speak NAOqi's protocol"


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        pytest.param(logged_in(1, 1), "the login is refused", id="refused"),
        pytest.param(logged_in(1, 2), "the login is refused", id="wants more than a token"),
        pytest.param(said(REPLY, 1, b"", magic=b"HTTP"), NO_ROBOT, id="another protocol"),
        pytest.param(said(REPLY, 1, b"", magic=bytes(4)), NO_ROBOT, id="zeros"),
        pytest.param(b"\x15\x03\x01\x00\x02\x02\x16" * 10, NO_ROBOT, id="TLS"),
        pytest.param(
            HEADER.pack(MAGIC, 1, MOST_BYTES + 1, 0, REPLY, 0, 0, 0, 8), NO_ROBOT, id="a lying length"
        ),
        pytest.param(HEADER.pack(MAGIC, 9, 2**32 - 1, 0, 5, 0, 0, 0, 8), NO_ROBOT, id="an event of 4 GB"),
    ],
)
def test_anything_but_a_robot_is_down_with_advice(message: bytes, complaint: str) -> None:
    with robot_of(lambda _: message) as robot, pytest.raises(RobotLost, match=complaint):
        robot.connect()


def drips(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    """Send the bytes of an answer so slowly that it never ends."""
    for byte in said(5, 0, bytes(100_000)):
        if goes_on():
            client.sendall(bytes([byte]))
            time.sleep(0.04)


def talks(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    """Send messages that were not asked for without end."""
    while goes_on():
        client.sendall(said(5, 0, bytes(1000)) * 100)


def reads_nothing(_client: socket.socket, goes_on: Callable[[], bool]) -> None:
    while goes_on():
        time.sleep(0.02)


@pytest.mark.parametrize("attack", [drips, talks, never_answers, reads_nothing])
@pytest.mark.parametrize("is_stopping", [False, True])
def test_every_wait_has_its_limit(attack: Attack, is_stopping: bool) -> None:
    limits = RobotLimits(connect_s=60.0 if is_stopping else 0.2)
    with session_with(attack, limits) as robot:
        if is_stopping:
            robot._stopping.set()  # type: ignore[attr-defined]
        started_s = time.monotonic()
        with pytest.raises(RobotLost, match=r"connecting: no answer within|did not|timed out"):
            robot.connect()
        assert time.monotonic() - started_s < AT_ONCE_S


def test_a_robot_that_dies_mid_message_is_lost_at_once() -> None:
    with (
        session_with(lambda client, _: client.sendall(logged_in(1)[:40])) as robot,
        pytest.raises(RobotLost, match=r"connecting: (disconnected|Connection reset)"),
    ):
        robot.connect()


def test_a_robot_that_stops_reading_is_lost_at_once() -> None:
    def reads_a_login(client: socket.socket, goes_on: Callable[[], bool]) -> None:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.sendall(logged_in(1) + said(REPLY, 2, info(client.getsockname()[1])) + said(REPLY, 3, META))
        reads_nothing(client, goes_on)

    with session_with(reads_a_login) as robot:
        robot.connect()
        started_s = time.monotonic()
        with pytest.raises(RobotLost, match=r"ALMemory\.raiseEvent: timed out"):
            robot.call("ALMemory", "raiseEvent", "Pad/Gesture", "x" * 50_000_000, limit_s=60.0)
        assert time.monotonic() - started_s < AT_ONCE_S


def info(port: int) -> bytes:
    """What the directory tells of a service in another process, at hosts of other networks."""
    endpoints = ["qi:relative", f"tcps://192.0.2.1:{port}", f"tcp://nao.invalid:{port}", "tcp://192.0.2.1:1"]
    return write("(sIsI[s]s)", ("ALMemory", 7, "robot", 1, endpoints, ""))


METHODS = {
    100: (100, "v", "raiseEvent", "(sm)", "", [], ""),
    101: (101, "v", "raiseEvent", "(sX)", "", [], ""),
    102: (102, "v", "fade", "(ssf)", "", [], ""),
    103: (103, "s", "fade", "(sif)", "", [], ""),
}
META = write("({I(Issss[(ss)]s)}s)", (METHODS, "more, which newer robots send"))


def test_a_service_in_another_process_has_its_own_connection() -> None:
    asked: list[tuple[int, int, int]] = []

    def other(sent: Sent) -> bytes:
        asked.append(sent[1])
        login = logged_in(sent[0]) if sent[1] == AUTHENTICATE else b""
        return login or said(REPLY, sent[0], META if sent[1][2] == 2 else b"")

    port = free_port()
    directory = after_login(lambda sent: said(REPLY, sent[0], info(port)))
    with robot_of(directory, RobotLimits()) as robot:
        robot.connect()
        with pytest.raises(RobotRefused, match="Connection refused"):
            robot.call("ALMemory", "raiseEvent", "Pad/Gesture", "pat", limit_s=5)
        # Its process has started.
        with server(port, by(other)):
            robot.call("ALMemory", "raiseEvent", "Pad/Gesture", "pat", limit_s=5)
    assert asked == [AUTHENTICATE, (7, 1, 2), (7, 1, 100)]


@pytest.mark.parametrize(
    ("found", "complaint"),
    [
        (lambda: info(free_port()), "Connection refused"),
        (lambda: info(99999), "port"),
        (lambda: b"\xff" * 40, "the answer cannot be read"),
    ],
    ids=["its process is away", "no port", "unreadable"],
)
def test_an_unreachable_service_is_refused_but_the_session_continues(
    found: Callable[[], bytes], complaint: str
) -> None:
    with robot_of(after_login(lambda sent: said(REPLY, sent[0], found()))) as robot:
        robot.connect()
        with pytest.raises(RobotRefused, match=f"looking for ALMemory: .*{complaint}"):
            robot.call("ALMemory", "getData", "Pad/Gesture", limit_s=5)
        assert robot.connected()


def test_a_refused_service_is_looked_up_with_its_methods_again() -> None:
    asked: list[int] = []

    def answer(sent: Sent) -> bytes:
        asked.append(sent[1][2])
        if len(asked) == 1:
            return said(ERROR, sent[0], write("m", "no such service"))
        found = {100: info(robot._port), 2: META}
        return said(REPLY, sent[0], found.get(sent[1][2], write("s", "done")))

    with robot_of(after_login(answer)) as robot:
        robot.connect()
        with pytest.raises(RobotRefused, match="no such service"):
            robot.call("ALMemory", "fade", "FaceLeds", 255, 1, limit_s=5)
        robot.call("ALMemory", "fade", "FaceLeds", 255, 1, limit_s=5)
        robot.call("ALMemory", "fade", "FaceLeds", "red", 0.5, limit_s=5)
    assert asked == [100, 100, 2, 103, 102]


WIDE = struct.pack("<I", MOST_BYTES - 9) + "\N{WAVING HAND SIGN}".encode() + b"x" * (MOST_BYTES - 13)
DEEP = write("s", "[" * 150_000 + "]" * 150_000) + b"\x01\0\0\0" * 2000
MANY = b"\xff" * MOST_BYTES
BOMBS = [
    *("[v]", "[[v]]", "[()]", "{v[v]}", "[b]", "[m]", "[s]", "[(bb)]", "[l]", "s", "r", "m", "X", "", "sv"),
    *("[" * 149 + "v" + "]" * 149, "(" * 150 + ")" * 150, "[", "]", "<", "()<", "(v)<a,b", "[vv]", "{b}"),
]


@pytest.mark.parametrize(
    ("signature", "data"),
    [
        *((own, MANY) for own in BOMBS),
        *(("s", WIDE), ("s", bytes(MOST_BYTES)), ("{[v]v}", struct.pack("<II", 1, 0))),
        *(("m", b"\x01\0\0\0m" * 80_000), ("m", DEEP)),
    ],
)
def test_no_message_takes_much_memory_or_time(signature: str, data: bytes) -> None:
    answer = (write("s", signature) + data)[:MOST_BYTES]
    line = Pieces([said(ERROR, 1, answer), said(ERROR, 2, answer)])
    tracemalloc.start()
    try:
        started_s = time.thread_time()
        with closing(WireSession(NAO, LIMITS, threading.Event())) as session, suppress(OSError, RobotRefused):
            session.use(line, endless)
            session._ask((1, 1, 1), b"", "s", endless)
        assert time.thread_time() - started_s < 3.0
        assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY_BYTES
    finally:
        tracemalloc.stop()


class Pieces(socket.socket):
    """A connection on which bytes come in pieces, and which then ends."""

    def __init__(self, pieces: list[bytes]) -> None:
        super().__init__()
        self._left = [piece for piece in pieces if piece]

    def recv(self, size: int, _flags: int = 0) -> bytes:
        piece = self._left.pop(0) if self._left else b""
        if piece[size:]:
            self._left.insert(0, piece[size:])
        return piece[:size]

    def sendall(self, data: Any, _flags: int = 0) -> None:
        pass


def endless() -> None:
    """Waits without a limit."""


ROBOTS = b"".join(
    bytes.fromhex(line.split()[1].replace("PORT", b"9559".hex()))
    for line in EXCHANGE.read_text().splitlines()
    if line.startswith("robot")
)


def damaged(changes: list[tuple[int, int, bytes]], size: int) -> bytes:
    data = bytearray(ROBOTS)
    for at, replaced, noise in changes:
        data[at : at + replaced] = noise
    return bytes(data[:size])


within = st.integers(0, len(ROBOTS))
changes = st.lists(st.tuples(within, st.integers(0, 40), st.binary(max_size=40)), max_size=6)


@settings(max_examples=300, deadline=None)
@given(
    st.one_of(st.binary(max_size=300), st.builds(damaged, changes, within)),
    st.lists(st.integers(1, 2000), max_size=20),
)
def test_any_bytes_lead_to_an_answer_or_a_lost_robot(sent: bytes, sizes: list[int]) -> None:
    pieces: list[bytes] = []
    for size in sizes:
        pieces, sent = [*pieces, sent[:size]], sent[size:]
    session = WireSession(NAO, LIMITS, threading.Event())
    tracemalloc.start()
    try:
        session.use(Pieces([*pieces, sent]), endless)
        session.call("ALSystem", "systemVersion", limit_s=1.0)
        session.call("ALMemory", "raiseEvent", "TouchGesture/Gesture", "pat", limit_s=1.0)
    except (OSError, RobotLost, RobotRefused):
        pass
    finally:
        assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY_BYTES
        tracemalloc.stop()
        session.close()
