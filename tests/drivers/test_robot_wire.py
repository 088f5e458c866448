"""The robot's protocol: what its server sent, and what no robot should send."""

import random
import socket
import struct
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rigs.attackers import server
from rigs.sockets import free_port
from rigs.wait import AT_ONCE_S

from touchd.drivers.robot.session import RobotLimits, RobotLost, RobotRefused, RobotSession, RobotSettings
from touchd.drivers.robot.values import ValueFault, read, write
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
Sent = tuple[int, tuple[int, int, int], bytes]
"""A message from the session: its id, its target and its payload."""
Script = Callable[[Sent], bytes]
"""Returns the bytes that answer a message."""


def said(kind: int, number: int, payload: bytes, *, flags: int = 0, magic: bytes = MAGIC) -> bytes:
    return HEADER.pack(magic, number, len(payload), 0, kind, flags, 1, 1, 100) + payload


def received(client: socket.socket) -> Iterator[Sent]:
    def exactly(size: int) -> bytes:
        data = b""
        while len(data) < size and (piece := client.recv(size - len(data))):
            data += piece
        return data

    while header := exactly(HEADER.size):
        _, number, size, _, _, _, service, of, action = HEADER.unpack(header)
        yield number, (service, of, action), exactly(size)


@contextmanager
def robot_of(script: Script, limits: RobotLimits = LIMITS) -> Iterator[RobotSession]:
    """A session, not yet connected, with a robot that answers each message by a script."""

    def answer(client: socket.socket, _goes_on: Callable[[], bool]) -> None:
        client.settimeout(10.0)
        for sent in received(client):
            client.sendall(script(sent))

    port = free_port()
    with server(port, answer), ExitStack() as closed:
        session = WireSession(RobotSettings(url=f"tcp://127.0.0.1:{port}"), limits, threading.Event())
        closed.callback(session.close)
        yield session


def logged_in(number: int, state: int = 3) -> bytes:
    return said(REPLY, number, write("{sm}", {AUTH_STATE: state}))


def after_login(script: Script) -> Script:
    return lambda sent: logged_in(sent[0]) if sent[1] == AUTHENTICATE else script(sent)


def test_a_recorded_robot_is_understood_message_by_message() -> None:
    port = free_port()
    messages = [
        (who, bytes.fromhex(message.replace("PORT", str(port).encode().hex())))
        for who, message in (line.split() for line in EXCHANGE.read_text().splitlines()[1:])
    ]
    wrong: list[bytes] = []

    def play(client: socket.socket, _goes_on: Callable[[], bool]) -> None:
        for who, message in messages:
            if who == "robot":
                client.sendall(message)
            elif (sent := client.recv(len(message), socket.MSG_WAITALL)) != message:
                wrong.append(sent)

    with (
        server(port, play),
        closing(
            WireSession(RobotSettings(url=f"tcp://127.0.0.1:{port}"), LIMITS, threading.Event())
        ) as robot,
    ):
        robot.connect()
        assert robot.call("ALSystem", "systemVersion", limit_s=5) == "2.8.7.4"
        detail = ["stroke", 0.75, [1_790_000_000, 250_000], "early", 7, 12]
        robot.call("ALMemory", "raiseEvent", "TouchGesture/Detail", detail, limit_s=5)
        assert robot.call("ALMemory", "getData", "TouchGesture/Detail", limit_s=5) == detail
        with pytest.raises(RobotRefused, match="no data named TouchGesture/Nothing"):
            robot.call("ALMemory", "getData", "TouchGesture/Nothing", limit_s=5)
    assert wrong == []


@pytest.mark.parametrize("message", [said(ERROR, 1, write("m", "no such action")), logged_in(1)])
def test_a_robot_with_and_without_a_login_is_reached(message: bytes) -> None:
    with robot_of(lambda _: message) as robot:
        robot.connect()
        assert robot.connected()


def test_a_login_may_take_two_rounds() -> None:
    with robot_of(lambda sent: logged_in(sent[0], 2 if sent[0] == 1 else 3)) as robot:
        robot.connect()


@pytest.mark.parametrize("state", [1, 2])
def test_a_refused_login_is_down_with_advice(state: int) -> None:
    with (
        robot_of(lambda sent: logged_in(sent[0], state)) as robot,
        pytest.raises(RobotLost, match=r"the login is refused; .* check user and token"),
    ):
        robot.connect()


@pytest.mark.parametrize(
    "between",
    [
        pytest.param(said(6, 1, write("{sm}", {"MessageFlags": True})), id="its capabilities"),
        pytest.param(said(5, 77, b"\xff" * 1000), id="an event"),
        pytest.param(said(CALL, 2, b""), id="a call with our number"),
        pytest.param(said(REPLY, 99, b"late"), id="a late answer"),
        pytest.param(said(4, 0, bytes(MOST_BYTES)), id="the longest message"),
        pytest.param(said(5, 1, b"") * 1000, id="a thousand events"),
    ],
)
def test_what_was_not_asked_for_is_skipped(between: bytes) -> None:
    with robot_of(lambda sent: between + logged_in(sent[0])) as robot:
        robot.connect()


@pytest.mark.parametrize(
    "message",
    [
        pytest.param(said(REPLY, 1, b"", magic=b"HTTP"), id="another protocol"),
        pytest.param(HEADER.pack(MAGIC, 1, MOST_BYTES + 1, 0, REPLY, 0, 0, 0, 8), id="a lying length"),
        pytest.param(HEADER.pack(MAGIC, 9, 2**32 - 1, 0, 5, 0, 0, 0, 8), id="an event of 4 GB"),
        pytest.param(b"\x15\x03\x01\x00\x02\x02\x16" * 10, id="TLS"),
    ],
)
def test_what_is_no_robot_is_down_with_advice(message: bytes) -> None:
    with robot_of(lambda _: message) as robot:
        started_s = time.monotonic()
        with pytest.raises(RobotLost, match=r"does not speak NAOqi's protocol; .* tcp:// or tcps://"):
            robot.connect()
        assert time.monotonic() - started_s < AT_ONCE_S


def drips(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    """Send the bytes of an answer so slowly that it never ends."""
    while goes_on():
        client.sendall(b"\x42")
        time.sleep(0.04)


def talks(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    """Send messages that were not asked for without end."""
    while goes_on():
        client.sendall(said(5, 0, bytes(1000)) * 100)


def stays_silent(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    while goes_on():
        time.sleep(0.02)


@pytest.mark.parametrize("attack", [drips, talks, stays_silent])
@pytest.mark.parametrize("is_stopping", [False, True])
def test_every_wait_has_its_limit(
    attack: Callable[[socket.socket, Callable[[], bool]], None], is_stopping: bool
) -> None:
    port, stopping = free_port(), threading.Event()
    limits = RobotLimits(connect_s=60.0 if is_stopping else 0.4)
    with (
        server(port, attack),
        closing(WireSession(RobotSettings(url=f"tcp://127.0.0.1:{port}"), limits, stopping)) as robot,
    ):
        if is_stopping:
            threading.Timer(0.1, stopping.set).start()
        started_s = time.monotonic()
        with pytest.raises(RobotLost, match=r"connecting: (no answer within|.* NAOqi's protocol)"):
            robot.connect()
        assert time.monotonic() - started_s < AT_ONCE_S


def info(port: int, host: str = "127.0.0.1") -> bytes:
    """What the directory tells of a service in another process."""
    return write("(sIsI[s]s)", ("ALMemory", 7, "robot", 1, [f"tcp://{host}:{port}"], ""))


METHODS = {
    100: (100, "v", "raiseEvent", "(sm)", "", [], ""),
    101: (101, "v", "raiseEvent", "(sX)", "", [], ""),
    102: (102, "v", "fade", "(ssf)", "", [], ""),
    103: (103, "s", "fade", "(sif)", "", [], ""),
}
META = write("({I(Issss[(ss)]s)}s)", (METHODS, "more, which newer robots send"))


@pytest.mark.parametrize("host", ["127.0.0.1", "192.0.2.1", "nao.invalid"])
def test_a_service_in_another_process_has_its_own_connection(host: str) -> None:
    asked: list[tuple[int, int, int]] = []

    def other(client: socket.socket, _goes_on: Callable[[], bool]) -> None:
        for number, target, _ in received(client):
            asked.append(target)
            answer = META if target[2] == 2 else b""
            client.sendall(logged_in(number) if target == AUTHENTICATE else said(REPLY, number, answer))

    port = free_port()
    directory = after_login(lambda sent: said(REPLY, sent[0], info(port, host)))
    with server(port, other), robot_of(directory, RobotLimits()) as robot:
        robot.connect()
        robot.call("ALMemory", "raiseEvent", "Pad/Gesture", "pat", limit_s=5)
    assert asked == [AUTHENTICATE, (7, 1, 2), (7, 1, 100)]


def test_a_service_whose_process_is_away_is_refused_and_the_session_goes_on() -> None:
    with robot_of(after_login(lambda sent: said(REPLY, sent[0], info(free_port())))) as robot:
        robot.connect()
        with pytest.raises(RobotRefused, match="looking for ALMemory: Connection refused"):
            robot.call("ALMemory", "getData", "Pad/Gesture", limit_s=5)
        assert robot.connected()


@pytest.mark.parametrize(
    ("arguments", "action"), [(("FaceLeds", 255, 1), 103), (("FaceLeds", "red", 0.5), 102)]
)
def test_the_method_that_takes_the_arguments_is_called(arguments: tuple[object, ...], action: int) -> None:
    asked: list[Sent] = []

    def answer(sent: Sent) -> bytes:
        asked.append(sent)
        number, target, _ = sent
        found = {100: info(int(robot._settings.address.port)), 2: META}  # type: ignore[attr-defined]
        return said(REPLY, number, found.get(target[2], write("s", "done")))

    with robot_of(after_login(answer)) as robot:
        robot.connect()
        robot.call("ALMemory", "fade", *arguments, limit_s=5)
    assert asked[-1][1] == (7, 1, action)


BOMBS = [
    *("[v]", "[[v]]", "[()]", "{v[v]}", "[b]", "[m]", "[s]", "[(bb)]", "[l]", "s", "r", "m", "X", "", "sv"),
    *("[" * 400 + "v" + "]" * 400, "(" * 400 + ")" * 400, "[", "]", "<", "()<", "(v)<a,b", "[vv]", "{b}"),
]


@pytest.mark.parametrize("signature", BOMBS)
def test_no_value_takes_much_memory_or_time(signature: str) -> None:
    data = (write("s", signature) + b"\xff" * MOST_BYTES)[:MOST_BYTES]
    started_s = time.thread_time()
    with suppress(ValueFault):
        read("m", data)
    assert time.thread_time() - started_s < 1.0
    tracemalloc.start()
    try:
        with suppress(ValueFault):
            read("m", data)
        # Beside the message itself.
        assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY_BYTES - MOST_BYTES
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("message", [said(REPLY, 1, bytes(MOST_BYTES)), said(REPLY, 1, b"\xff" * MOST_BYTES)])
def test_the_longest_message_takes_little_memory(message: bytes) -> None:
    with robot_of(lambda _: message, RobotLimits(connect_s=20.0)) as robot:
        tracemalloc.start()
        try:
            with suppress(RobotLost):
                robot.connect()
            assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY_BYTES
        finally:
            tracemalloc.stop()


@pytest.mark.parametrize("answer", [b"", b"\xff" * 40, write("{sm}", {"a": 1})[:-1]])
def test_a_login_that_cannot_be_read_is_no_robot(answer: bytes) -> None:
    with (
        robot_of(lambda sent: said(REPLY, sent[0], answer)) as robot,
        pytest.raises(RobotLost, match=r"connecting: the answer cannot be read .*; if a robot is there"),
    ):
        robot.connect()


def test_a_service_that_cannot_be_read_is_refused_and_the_session_goes_on() -> None:
    with robot_of(after_login(lambda sent: said(REPLY, sent[0], b"\xff" * 40))) as robot:
        robot.connect()
        with pytest.raises(RobotRefused, match="looking for ALMemory: the answer cannot be read"):
            robot.call("ALMemory", "getData", "Pad/Gesture", limit_s=5)
        assert robot.connected()


def test_a_text_of_wide_characters_takes_little_memory() -> None:
    data = struct.pack("<I", MOST_BYTES - 4) + "\N{WAVING HAND SIGN}".encode() + b"x" * (MOST_BYTES - 8)
    tracemalloc.start()
    try:
        with pytest.raises(ValueFault):
            read("s", data)
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


signatures = st.recursive(
    st.sampled_from(list("bcCwWiIlLfdsrmv")),
    lambda inner: st.one_of(
        inner.map("[{}]".format),
        st.lists(inner, max_size=4).map(lambda members: f"({''.join(members)})"),
        st.tuples(st.sampled_from("isL"), inner).map(lambda pair: f"{{{pair[0]}{pair[1]}}}"),
    ),
    max_leaves=8,
)


@settings(max_examples=200, deadline=None)
@given(st.one_of(signatures, st.text("bsm[](){}<>,iXv", max_size=40)), st.binary(max_size=200))
def test_any_bytes_are_a_value_or_a_fault(signature: str, data: bytes) -> None:
    with suppress(ValueFault):
        read(signature, data)


plain = st.recursive(
    st.one_of(
        st.booleans(),
        st.integers(-(2**63), 2**63 - 1),
        # ONNX Runtime, where another test has loaded it, counts denormals as zero.
        st.floats(allow_nan=False, allow_subnormal=False),
        st.text(st.characters(codec="utf-8"), max_size=20),
    ),
    lambda inner: st.lists(inner, max_size=5),
    max_leaves=20,
)


@settings(max_examples=100, deadline=None)
@given(plain)
def test_what_is_written_is_read_again(value: object) -> None:
    assert read("m", write("m", value)) == value


def mutated(messages: bytes, seed: int) -> bytes:
    """Cut, repeat and change bytes of what a robot sent."""
    noise = random.Random(seed)
    data = bytearray(messages)
    for _ in range(noise.randrange(1, 8)):
        at = noise.randrange(len(data)) if data else 0
        match noise.randrange(4):
            case 0:
                data[at : at + 1] = bytes([noise.randrange(256)])
            case 1:
                del data[at : at + noise.randrange(40)]
            case 2:
                data[at:at] = noise.randbytes(noise.randrange(40))
            case _:
                data[at : at + 4] = struct.pack("<I", noise.choice([0, 1, 2**16, 2**31, 2**32 - 1]))
    return bytes(data[: noise.randrange(len(data) + 1)] if noise.random() < 0.5 else data)


@pytest.fixture(scope="module")
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.one_of(st.binary(max_size=300), st.integers(0, 2**32).map(lambda seed: seed)))
def test_any_bytes_end_in_an_answer_or_a_lost_robot(listener: socket.socket, sent: bytes | int) -> None:
    port = listener.getsockname()[1]
    if isinstance(sent, int):
        lines = EXCHANGE.read_text().replace("PORT", str(port).encode().hex()).splitlines()[1:]
        robots = b"".join(bytes.fromhex(line.split()[1]) for line in lines if line.startswith("robot"))
        sent = mutated(robots, sent)
    limits = RobotLimits(connect_s=1.0)
    session = WireSession(RobotSettings(url=f"tcp://127.0.0.1:{port}"), limits, threading.Event())

    def serve() -> None:
        with listener.accept()[0] as client, suppress(OSError):
            client.sendall(sent)
            client.shutdown(socket.SHUT_WR)
            while client.recv(65536):
                pass

    serving = threading.Thread(target=serve)
    serving.start()
    started_s = time.monotonic()
    try:
        session.connect()
        session.call("ALSystem", "systemVersion", limit_s=1.0)
        session.call("ALMemory", "raiseEvent", "TouchGesture/Gesture", "pat", limit_s=1.0)
    except (RobotLost, RobotRefused):
        pass
    finally:
        session.close()
        serving.join()
    assert time.monotonic() - started_s < 2 * AT_ONCE_S
