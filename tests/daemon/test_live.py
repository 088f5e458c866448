"""The live page's server: viewers get every event, none slows the daemon, and few may do anything."""

import http.client
import json
import logging
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import msgspec
import numpy as np
import pytest
from rigs.live_rig import HANDSHAKE, Served, frames_among, serving
from rigs.made_events import PREDICTION, TIME
from rigs.wait import WITHIN_S, wait_for
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from touchd.daemon.app import cli
from touchd.daemon.app.cli import complain
from touchd.daemon.app.config import ConfigError, LiveSettings, Settings
from touchd.daemon.commands.settings import load_model
from touchd.daemon.live import viewers
from touchd.daemon.live.address import LiveError, is_own_host, listen, own_names, parse_address
from touchd.daemon.live.memory import Memory, Scene
from touchd.daemon.live.page import FOLDER
from touchd.daemon.live.server import CAPACITY, HANDSHAKE_S, MOST_CONNECTIONS, LiveServer
from touchd.daemon.live.viewers import MOST_VIEWERS
from touchd.daemon.path.events import SensorEvent, TouchBegan, TouchEnded, encode
from touchd.daemon.sinks.touches import PREDICTIONS, TOUCHES

BEGAN = TouchBegan(touch=1, time=TIME, sensor_ms=7)
ENDED = TouchEnded(touch=1, gesture="pat", frames=60, reason="released", time=TIME)
BEGAN_AGAIN = TouchBegan(touch=2, time=TIME, sensor_ms=9)
PAD_UP = SensorEvent(state="up", time=TIME)


@pytest.fixture
def viewer(served: Served) -> Iterator[ClientConnection]:
    """A viewer of the page that has got the state."""
    with served.look(max_queue=None) as viewer:
        assert json.loads(viewer.recv(timeout=WITHIN_S))["type"] == "state"
        yield viewer


def await_message(viewer: ClientConnection, kind: str) -> dict[str, object]:
    """Return the next message of a kind."""
    while True:
        message = viewer.recv(timeout=WITHIN_S)
        if isinstance(message, str) and (told := json.loads(message))["type"] == kind:
            return dict(told)


def test_a_viewer_gets_every_event_and_frame(served: Served, viewer: ClientConnection) -> None:
    served.sink.put(BEGAN)
    wanted = served.put_frame()
    assert frames_among(viewer, wanted) == [encode(BEGAN).decode(), wanted]


def test_a_late_viewer_gets_the_current_state(served: Served, viewer: ClientConnection) -> None:
    for event in (PAD_UP, BEGAN, ENDED, BEGAN_AGAIN):
        served.sink.put(event)
    frames_among(viewer, served.put_frame())
    with served.look() as late:
        state = json.loads(late.recv(timeout=WITHIN_S))
    touches = [(touch["began"]["touch"], touch["ended"] is not None) for touch in state["touches"]]
    assert touches == [(1, True), (2, False)]
    assert state["sensor"]["state"] == "up"
    assert state["model"] == served.models["pad"].name
    assert state["answer_at_frames"] == [54, 81, 144]
    assert (state["touchable"], state["may_label"]) == (False, False)


def test_the_memory_for_late_viewers_is_bounded() -> None:
    memory = Memory(Scene(Settings(), load_model(Settings())))
    for touch in range(1, 3 * TOUCHES):
        memory.put(TouchBegan(touch=touch, time=TIME, sensor_ms=0))
        for _ in range(2 * PREDICTIONS):
            memory.put(msgspec.structs.replace(PREDICTION, touch=touch))
    touches: Any = memory.state("", "pad", ["pad"])["touches"]
    assert [found.began.touch for found in touches] == list(range(2 * TOUCHES, 3 * TOUCHES))
    assert {len(found.predictions) for found in touches} == {PREDICTIONS}


def test_an_event_is_shown_even_without_a_frame(served: Served, viewer: ClientConnection) -> None:
    served.sink.put(SensorEvent(state="down", time=TIME, reason="unplugged"))
    assert await_message(viewer, "sensor")["reason"] == "unplugged"


def test_rate_and_drops_are_sent_repeatedly(served: Served, viewer: ClientConnection) -> None:
    assert await_message(viewer, "status")["rate_hz"] == 0.0
    for _ in range(2):
        frames_among(viewer, served.put_frame())
    status = await_message(viewer, "status")
    assert status["rate_hz"] > 0
    assert status["dropped"] == 0


@pytest.fixture
def narrow() -> socket.socket:
    """A socket for a viewer that reads nothing."""
    narrow = socket.socket()
    narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    return narrow


def test_a_stalled_viewer_does_not_affect_the_others(
    narrow: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    # It answers no ping while it reads nothing, which takes a busy machine longer than usual.
    monkeypatch.setattr("touchd.daemon.live.server.PING_EVERY_S", WITHIN_S)
    with serving() as served, served.look(max_queue=None) as viewer:
        narrow.connect(("127.0.0.1", served.port))
        with served.look(sock=narrow, max_queue=1, ping_interval=None) as slow:
            for _ in range(600):
                frames_among(viewer, served.put_frame())
            served.sink.put(BEGAN)
            newest = served.put_frame()
            frames_among(viewer, newest)
            assert served.sink.dropped == 0

            backlog: list[str | bytes] = []
            while newest not in backlog:
                try:
                    backlog.append(slow.recv(timeout=0.1))
                except TimeoutError:
                    newest = served.put_frame()
    # Frames are missing, no event is.
    assert len(backlog) < 400
    assert encode(BEGAN).decode() in backlog


def test_a_viewer_far_behind_is_disconnected(
    narrow: socket.socket, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(viewers, "MOST_WAITING_BYTES", 100_000)
    with serving() as served:
        narrow.connect(("127.0.0.1", served.port))
        with served.look(sock=narrow, max_queue=1, ping_interval=None, close_timeout=0.1):
            wait_for(lambda: served.sink.is_watched)
            for _ in range(CAPACITY // 2):
                served.sink.put(msgspec.structs.replace(PAD_UP, reason="x" * 1000))
            wait_for(lambda: not served.sink.is_watched)
    # asyncio warns of what is sent to a lost connection.
    assert [record.message for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_a_late_viewer_gets_the_pads_rest(served: Served) -> None:
    for _ in range(60):
        served.put_frame(np.full((8, 8), 100, np.uint16))
    for _ in range(30):
        served.put_frame(np.full((8, 8), 500, np.uint16))
    served.sink.put(BEGAN)
    with served.look() as viewer:
        assert await_message(viewer, "touch_began")
    with served.look() as late:
        assert await_message(late, "state")["rest"] == [100.0] * 64


def test_an_unresponsive_viewer_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchd.daemon.live.server.PING_EVERY_S", 0.2)
    with serving() as served, socket.create_connection(("127.0.0.1", served.port), timeout=WITHIN_S) as dead:
        dead.sendall(HANDSHAKE.format(port=served.port).encode())
        with suppress(ConnectionResetError):
            while dead.recv(65536):
                pass


@contextmanager
def hung(server: LiveServer) -> Iterator[None]:
    """Block the page's thread."""
    hangs, goes_on = threading.Event(), threading.Event()

    def hang() -> None:
        hangs.set()
        goes_on.wait()

    server._loop.call_soon_threadsafe(hang)
    assert hangs.wait(WITHIN_S)
    try:
        yield
    finally:
        goes_on.set()


def test_a_hanging_page_thread_delays_no_event(served: Served) -> None:
    with hung(served.sink):
        for _ in range(CAPACITY + 7):
            served.sink.put(PAD_UP)
        assert served.sink.dropped == 7


def test_a_later_viewer_gets_the_state_despite_a_flood(served: Served, viewer: ClientConnection) -> None:
    with hung(served.sink):
        served.sink.put(PAD_UP)
        for _ in range(CAPACITY + 7):
            served.put_frame()
    with served.look() as later:
        assert await_message(later, "state")["sensor"]["state"] == "up"


def test_stopping_does_not_wait_for_viewers(served: Served, viewer: ClientConnection) -> None:
    with hung(served.sink):
        for _ in range(CAPACITY):
            served.put_frame()
        served.sink.stop(0.0)
    shown: list[str | bytes] = []
    with suppress(ConnectionClosed):
        while True:
            shown.append(viewer.recv(timeout=WITHIN_S))
    assert [message for message in shown if isinstance(message, bytes)] == []


def test_a_viewer_over_the_limit_is_refused(served: Served) -> None:
    with ExitStack() as closing:
        viewers = [closing.enter_context(served.look()) for _ in range(MOST_VIEWERS)]
        for viewer in viewers:
            viewer.recv(timeout=WITHIN_S)
        one_more = closing.enter_context(served.look())
        with pytest.raises(ConnectionClosed, match="too many are looking already"):
            one_more.recv(timeout=WITHIN_S)
        viewers[0].close()
        wanted = served.put_frame()
        for viewer in viewers[1:]:
            frames_among(viewer, wanted)


@pytest.mark.parametrize(("said", "why"), [("x", "nothing is read here"), ("x" * 1000, "1009")])
def test_a_viewer_that_sends_data_is_disconnected(served: Served, said: str, why: str) -> None:
    with served.look() as viewer:
        viewer.recv(timeout=WITHIN_S)
        viewer.send(said)
        with pytest.raises(ConnectionClosed, match=why):
            viewer.recv(timeout=WITHIN_S)


def test_half_open_connections_lock_nobody_out(served: Served) -> None:
    with served.look() as viewer, ExitStack() as closing:
        viewer.recv(timeout=WITHIN_S)
        idle = [
            closing.enter_context(socket.create_connection(("127.0.0.1", served.port), timeout=WITHIN_S))
            for _ in range(3 * MOST_CONNECTIONS)
        ]
        began_s = time.monotonic()
        # The first is closed before it times out.
        with suppress(ConnectionResetError):
            assert idle[0].recv(1) == b""
        for _ in range(5):
            assert served.ask("/").status == 200
            with served.look() as another:
                another.recv(timeout=WITHIN_S)
        frames_among(viewer, served.put_frame())
        assert time.monotonic() - began_s < HANDSHAKE_S


@pytest.mark.parametrize("path", ["/", *sorted(f"/{path.name}" for path in FOLDER.iterdir())])
def test_the_page_loads_nothing_from_elsewhere(served: Served, path: str) -> None:
    answer = served.ask(path)
    assert answer.status == 200
    policy = answer.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none';")
    assert "unsafe" not in policy
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    text = answer.read().decode()
    assert text == (FOLDER / (path[1:] or "page.html")).read_text()
    assert "://" not in text.replace("http://www.w3.org/2000/svg", "").replace("${scheme}//", "")


@pytest.mark.parametrize("path", ["/server.py", "/../server.py", "/%2e%2e/server.py", "//etc/passwd", "/x"])
def test_other_paths_are_not_found(served: Served, path: str) -> None:
    assert served.ask(path).status == 404


def test_only_get_requests_are_accepted(served: Served) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=WITHIN_S)
    with suppress(http.client.RemoteDisconnected):
        connection.request("POST", "/", body=b"x")
        assert connection.getresponse().status >= 400
    assert served.ask("/").status == 200


@pytest.mark.parametrize("path", ["/", "/stream"])
def test_a_foreign_host_name_is_refused(served: Served, path: str) -> None:
    answer = served.ask(path, Host=f"evil.example:{served.port}")
    assert answer.status == 403
    assert "live:\n    host: NAME" in answer.read().decode()


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_a_foreign_origin_gets_no_stream(served: Served, origin: str) -> None:
    with pytest.raises(InvalidStatus, match="403"), served.look(origin=origin):
        pass
    with served.look(origin=f"http://127.0.0.1:{served.port}") as viewer:
        viewer.recv(timeout=WITHIN_S)


@pytest.mark.parametrize(
    ("host", "is_own"),
    [
        ("localhost", True),
        ("LOCALHOST:9000", True),
        ("127.0.0.1:8054", True),
        ("192.168.1.7:8054", True),
        ("[::1]:8054", True),
        ("robot.lab:8054", True),
        ("evil.example", False),
        ("localhost.evil.example:8054", False),
        ("127.0.0.1.evil.example", False),
        ("localhost:8054:8054", False),
        ("", False),
    ],
)
def test_own_host_names_and_addresses_are_recognised(host: str, is_own: bool) -> None:
    assert is_own_host(host, frozenset({"localhost", "robot.lab"})) is is_own


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("", "10.0.0.1", 99),
        ("8080", "10.0.0.1", 8080),
        (":8080", "10.0.0.1", 8080),
        ("0.0.0.0:8080", "0.0.0.0", 8080),
        ("[::1]:8080", "::1", 8080),
    ],
)
def test_missing_parts_of_an_address_come_from_the_configuration(text: str, host: str, port: int) -> None:
    assert parse_address(text, LiveSettings(host="10.0.0.1", port=99)) == LiveSettings(host=host, port=port)


def test_by_default_only_this_computer_sees_the_page() -> None:
    assert parse_address("", None) == LiveSettings(host="127.0.0.1", port=8054)


@pytest.mark.parametrize(
    "text", ["x", "localhost", "localhost:", "1:65536", "1:-1", "1:²", "::1", "fe80::1:8080"]
)
def test_an_invalid_address_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"not \[HOST:\]PORT"):
        parse_address(text, None)


@pytest.mark.parametrize("command", ["run", "demo"])
def test_a_port_in_use_is_reported_in_one_line(command: str, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert cli.main([command, "--live", str(port)]) == 2
    said = capfd.readouterr().err.splitlines()
    assert len(said) == 1
    assert f"cannot listen on 127.0.0.1 port {port}: another program does" in said[0]
    assert "--live 127.0.0.1:8061" in said[0]


def test_a_name_with_an_ipv6_address_alone_is_served(monkeypatch: pytest.MonkeyPatch) -> None:
    six = (socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("::1", 0, 0, 0))
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: [six])
    with listen(LiveSettings(host="localhost", port=0)) as listening:
        assert listening.getsockname()[0] == "::1"


def test_a_name_with_both_addresses_is_served_at_ipv4() -> None:
    with listen(LiveSettings(host="localhost", port=0)) as listening:
        assert listening.getsockname()[0] == "127.0.0.1"


@pytest.mark.parametrize("found", [("192.0.2.1", 0), None], ids=["elsewhere", "nowhere"])
def test_a_name_of_another_computer_is_served_and_answered_to(
    found: tuple[str, int] | None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    look_up = socket.getaddrinfo

    def getaddrinfo(host: str, *arguments: object, **options: object) -> object:
        if host != "labserver":
            return look_up(host, *arguments, **options)  # type: ignore[arg-type]
        if found is None:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", found)]

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
    settings = LiveSettings(host="labserver", port=0)
    with listen(settings) as listening:
        assert listening.getsockname()[0] == "0.0.0.0"
    assert "labserver is no name of this computer; serving at all of its addresses" in caplog.text
    assert is_own_host("labserver:8054", own_names(settings))


def test_an_address_of_another_computer_is_refused_and_tried_again_by_systemd() -> None:
    with pytest.raises(LiveError, match="this computer has no such address") as raised:
        listen(LiveSettings(host="192.0.2.1", port=0))
    # At boot the address may come late; systemd does not start the service again after 2.
    assert complain(raised.value) == 1
