"""The live page's server: viewers get every event, none slows the daemon, and few may do anything."""

import http.client
import json
import logging
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from rigs.live_rig import HANDSHAKE, Served, frames_among, serving
from rigs.made_events import PREDICTION, TIME
from rigs.wait import WITHIN_S, wait_for
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.http11 import Request
from websockets.sync.client import ClientConnection

from touchd.daemon.app import cli
from touchd.daemon.app.cli import complain
from touchd.daemon.app.config import ConfigError, LiveSettings, Settings
from touchd.daemon.live import server, viewers
from touchd.daemon.live.address import LiveError, is_own_host, listen, own_names, parse_address
from touchd.daemon.live.memory import Memory
from touchd.daemon.live.page import FOLDER
from touchd.daemon.live.server import CAPACITY, HANDSHAKE_S, LiveServer
from touchd.daemon.live.viewers import MOST_CONNECTIONS, MOST_VIEWERS, is_here
from touchd.daemon.path.events import SensorEvent, TouchBegan, TouchEnded, encode
from touchd.daemon.sinks.touches import PREDICTIONS, TOUCHES

BEGAN = TouchBegan(touch=1, time=TIME, sensor_ms=7)
ENDED = TouchEnded(touch=1, gesture="pat", frames=60, reason="released", time=TIME)
PAD_UP = SensorEvent(state="up", time=TIME)


@pytest.fixture
def viewer(served: Served) -> Iterator[ClientConnection]:
    """A viewer of the page that has got the state."""
    with served.look(max_queue=None) as viewer:
        assert json.loads(viewer.recv(timeout=WITHIN_S))["type"] == "state"
        yield viewer


def await_message(viewer: ClientConnection, kind: str) -> dict[str, Any]:
    """Return the next message of a kind."""
    while True:
        message = viewer.recv(timeout=WITHIN_S)
        if isinstance(message, str) and (told := json.loads(message))["type"] == kind:
            return dict(told)


def refusal(served: Served, message: str = "", **options: Any) -> str:
    """Return why a viewer, who sends this, is disconnected."""
    with served.look(**options) as viewer:
        if message:
            viewer.send(message)
        try:
            while True:
                viewer.recv(timeout=WITHIN_S)
        except ConnectionClosed as closed:
            return str(closed)


def test_a_viewer_gets_every_event_and_frame(served: Served, viewer: ClientConnection) -> None:
    served.sink.put(BEGAN)
    wanted = served.put_frame()
    assert frames_among(viewer, wanted) == [encode(BEGAN).decode(), wanted]


def test_a_late_viewer_gets_the_current_state(served: Served, viewer: ClientConnection) -> None:
    for counts in (*[100] * 60, *[500] * 30):
        served.put_frame(np.full((8, 8), counts, np.uint16))
    for event in (PAD_UP, BEGAN, ENDED, msgspec.structs.replace(BEGAN, touch=2)):
        served.sink.put(event)
    frames_among(viewer, served.put_frame())
    with served.look() as late:
        state = await_message(late, "state")
    touches = [(touch["began"]["touch"], touch["ended"] is not None) for touch in state["touches"]]
    assert touches == [(1, True), (2, False)]
    assert state["sensor"]["state"] == "up"
    assert state["rest"] == [100.0] * 64
    assert state["model"] == served.models["pad"].name
    assert state["answer_at_frames"] == [54, 81, 144]
    assert (state["touchable"], state["may_label"]) == (False, False)


def test_the_memory_for_late_viewers_is_bounded(served: Served) -> None:
    memory = Memory(Settings(), served.models["pad"])
    for touch in range(1, 3 * TOUCHES):
        memory.put(TouchBegan(touch=touch, time=TIME, sensor_ms=0))
        for _ in range(2 * PREDICTIONS):
            memory.put(msgspec.structs.replace(PREDICTION, touch=touch))
    touches: Any = memory.state()["touches"]
    assert [found.began.touch for found in touches] == list(range(2 * TOUCHES, 3 * TOUCHES))
    assert {len(found.predictions) for found in touches} == {PREDICTIONS}


def test_events_rate_and_drops_are_sent_without_a_frame(served: Served, viewer: ClientConnection) -> None:
    served.sink.put(SensorEvent(state="down", time=TIME, reason="unplugged"))
    assert await_message(viewer, "sensor")["reason"] == "unplugged"
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
    monkeypatch.setattr(server, "PING_EVERY_S", WITHIN_S)
    with serving() as served, served.look(max_queue=None) as viewer:
        narrow.connect(("127.0.0.1", served.port))
        with served.look(sock=narrow, max_queue=1, ping_interval=None) as slow:
            for _ in range(600):
                frames_among(viewer, served.put_frame())
            served.sink.put(BEGAN)
            newest = served.put_frame()
            frames_among(viewer, newest)
            assert served.sink._items.dropped == 0

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


def test_an_unresponsive_viewer_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "PING_EVERY_S", 0.2)
    with serving() as served, socket.create_connection(("127.0.0.1", served.port), timeout=WITHIN_S) as dead:
        dead.sendall(HANDSHAKE.format(port=served.port).encode())
        with suppress(ConnectionResetError):
            while dead.recv(65536):
                pass


@contextmanager
def hung(page: LiveServer) -> Iterator[None]:
    """Block the page's thread."""
    hangs, goes_on = threading.Event(), threading.Event()

    def hang() -> None:
        hangs.set()
        goes_on.wait()

    page._loop.call_soon_threadsafe(hang)
    assert hangs.wait(WITHIN_S)
    try:
        yield
    finally:
        goes_on.set()


def test_a_hanging_page_thread_delays_no_event(served: Served) -> None:
    with hung(served.sink):
        for _ in range(CAPACITY + 7):
            served.sink.put(PAD_UP)
        assert served.sink._items.dropped == 7


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
    with suppress(ConnectionClosed):
        while True:
            assert isinstance(viewer.recv(timeout=WITHIN_S), str)


def test_a_viewer_over_the_limit_is_refused(served: Served) -> None:
    with ExitStack() as closing:
        inside = [closing.enter_context(served.look()) for _ in range(MOST_VIEWERS)]
        for viewer in inside:
            viewer.recv(timeout=WITHIN_S)
        assert "too many are looking already" in refusal(served)
        inside[0].close()
        wanted = served.put_frame()
        for viewer in inside[1:]:
            frames_among(viewer, wanted)


def test_half_open_connections_lock_nobody_out(served: Served, viewer: ClientConnection) -> None:
    with ExitStack() as closing:
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


def test_the_page_loads_nothing_from_elsewhere(served: Served) -> None:
    for path in ("/", *(f"/{path.name}" for path in FOLDER.iterdir())):
        answer = served.ask(path)
        assert answer.status == 200
        policy = answer.headers["Content-Security-Policy"]
        assert policy.startswith("default-src 'none';")
        assert "unsafe" not in policy
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        text = answer.read().decode()
        assert text == (FOLDER / (path[1:] or "page.html")).read_text()
        assert "://" not in text.replace("http://www.w3.org/2000/svg", "").replace("${scheme}//", "")


def test_other_paths_and_requests_are_refused(served: Served) -> None:
    for path in ("/server.py", "/../server.py", "/%2e%2e/server.py", "//etc/passwd", "/x"):
        assert served.ask(path).status == 404
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=WITHIN_S)
    with suppress(http.client.RemoteDisconnected):
        connection.request("POST", "/", body=b"x")
        assert connection.getresponse().status >= 400
    assert served.ask("/").status == 200


def test_a_foreign_host_name_or_origin_is_refused(served: Served) -> None:
    for path in ("/", "/stream"):
        answer = served.ask(path, Host=f"evil.example:{served.port}")
        assert answer.status == 403
        assert "live:\n    host: NAME" in answer.read().decode()
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1"):
        with pytest.raises(InvalidStatus, match="403"), served.look(origin=origin):
            pass
    with served.look(origin=f"http://127.0.0.1:{served.port}") as viewer:
        viewer.recv(timeout=WITHIN_S)


@pytest.mark.parametrize(("message", "why"), [("x", "nothing is read here"), ("x" * 1000, "1009")])
def test_a_viewer_that_sends_data_is_disconnected(served: Served, message: str, why: str) -> None:
    assert why in refusal(served, message)


@pytest.mark.parametrize(
    ("message", "headers", "why"),
    [
        ("x", {}, "not a label"),
        ("[]", {}, "not a label"),
        ('{"pad":"pad","touch":-1,"gesture":"pat"}', {}, "not a label"),
        ('{"pad":"pad","touch":1,"gesture":"pat","more":1}', {}, "not a label"),
        ('{"pad":"pad","touch":2,"gesture":"pat"}', {}, "no such touch"),
        ('{"pad":"other","touch":1,"gesture":"pat"}', {}, "no such touch"),
        ('{"pad":"pad","touch":1,"gesture":"purr"}', {}, "no such gesture"),
        ('{"pad":"pad","touch":1,"gesture":"pat"}', {"Forwarded": "203.0.113.5"}, "only this computer"),
        ('{"pad":"pad","touch":1,"gesture":"pat"}', {"X-Forwarded-For": "203.0.113.5"}, "only this computer"),
        ('{"pad":"pad","touch":1,"gesture":"pat"}', {"Via": "203.0.113.5"}, "only this computer"),
    ],
)
def test_a_message_that_is_not_a_label_is_refused(message: str, headers: dict[str, str], why: str) -> None:
    with serving(label=True) as served, served.look() as viewer:
        served.sink.put(BEGAN)
        served.put_frame()
        await_message(viewer, "touch_began")
        assert why in refusal(served, message, additional_headers=headers)
        assert served.labels == []


@pytest.mark.parametrize(
    ("address", "host", "is_ours"),
    [
        ("127.0.0.1", "127.0.0.1:8054", True),
        ("127.0.0.1", "localhost:8054", True),
        ("::1", "[::1]:8054", True),
        ("::ffff:127.0.0.1", "localhost", True),
        ("192.168.1.7", "192.168.1.2:8054", False),
        ("192.168.1.7", "localhost:8054", False),
        ("::ffff:192.168.1.7", "localhost:8054", False),
        ("fe80::1", "[::1]:8054", False),
        ("127.0.0.1", "robot.local:8054", False),
        ("127.0.0.1", "192.168.1.2:8054", False),
        ("127.0.0.1", "localhost.example.com:8054", False),
    ],
)
def test_nobody_but_this_computer_may_label(address: str, host: str, is_ours: bool) -> None:
    request = Request("/stream", Headers({"Host": host}))
    viewer: Any = SimpleNamespace(remote_address=(address, 40000), request=request)
    assert is_here(viewer) == is_ours


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


CONFIGURED = LiveSettings(host="10.0.0.1", port=99)


@pytest.mark.parametrize(
    ("text", "configured", "host", "port"),
    [
        ("", None, "127.0.0.1", 8054),
        ("", CONFIGURED, "10.0.0.1", 99),
        ("8080", CONFIGURED, "10.0.0.1", 8080),
        (":8080", CONFIGURED, "10.0.0.1", 8080),
        ("0.0.0.0:8080", CONFIGURED, "0.0.0.0", 8080),
        ("[::1]:8080", CONFIGURED, "::1", 8080),
    ],
)
def test_missing_parts_of_an_address_are_as_configured(
    text: str, configured: LiveSettings | None, host: str, port: int
) -> None:
    assert parse_address(text, configured) == LiveSettings(host=host, port=port)


@pytest.mark.parametrize(
    "text", ["x", "localhost", "localhost:", "1:65536", "1:-1", "1:²", "::1", "fe80::1:8080"]
)
def test_an_invalid_address_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"not \[HOST:\]PORT"):
        parse_address(text, None)


@pytest.mark.parametrize(
    ("command", "host", "shown", "advice"),
    [
        ("run", "127.0.0.1", "127.0.0.1", "--live 127.0.0.1:8061"),
        ("demo", "0.0.0.0", "0.0.0.0", "--live 0.0.0.0:8061"),
        ("fake-pad", "[::1]", "::1", "--live [::1]:8061"),
    ],
)
def test_a_used_port_is_reported_with_a_free_address(
    capfd: pytest.CaptureFixture[str], command: str, host: str, shown: str, advice: str
) -> None:
    with listen(LiveSettings(host=shown, port=0)) as taken:
        port = taken.getsockname()[1]
        assert cli.main([command, "--live", f"{host}:{port}"]) == 2
    (said,) = capfd.readouterr().err.splitlines()
    assert f"cannot listen on {shown} port {port}: another program does" in said
    assert said.endswith(advice)


@pytest.mark.parametrize(
    ("name", "found", "address"),
    [
        ("localhost", "::1", "::1"),
        ("localhost", "::1 127.0.0.1", "127.0.0.1"),
        # The name of another computer, by which others know this one.
        ("labserver", "192.0.2.1", "0.0.0.0"),
    ],
)
def test_the_page_is_served_and_answered_by_any_name(
    name: str,
    found: str,
    address: str,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    look_up = socket.getaddrinfo

    def getaddrinfo(host: bytes, port: int, **options: Any) -> list[Any]:
        numbers = found.split() if host == name.encode() else [host]
        return [entry for number in numbers for entry in look_up(number, port, **options)]

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
    settings = LiveSettings(host=name, port=0)
    page = LiveServer(Settings(live=settings), {"pad": None})
    assert page.listening.getsockname()[0] == address
    # Not before: the log is not set up while the daemon's parts are made.
    assert not caplog.messages
    page.start()
    page.stop(WITHIN_S)
    warned = f"{name} is no name of this computer; serving at all of its addresses"
    assert (warned in caplog.text) == (address == "0.0.0.0")
    assert is_own_host(f"{name}:8054", own_names(settings))


# systemd does not start the service again after code 2, only for what may come late at boot.
@pytest.mark.parametrize(
    ("host", "failure", "why", "code"),
    [
        ("192.0.2.1", 0, "this computer has no such address", 1),
        ("labserver", socket.EAI_AGAIN, "no answer; choose another address", 1),
        ("labserver", socket.EAI_NONAME, "no such name is known; check it, or", 2),
        # Python's codec for names of other scripts refuses it.
        ("a..b", socket.EAI_NONAME, "no such name is known; check it, or", 2),
    ],
)
def test_an_address_that_cannot_be_served_is_refused(
    host: str, failure: int, why: str, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def getaddrinfo(host: str | bytes, *_: object, **__: object) -> None:
        assert isinstance(host, bytes) or host.encode("idna")
        raise socket.gaierror(failure, "no answer")

    if failure:
        monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
    with pytest.raises(LiveError, match=f"{host} port 0: {why}") as raised:
        listen(LiveSettings(host=host, port=0))
    assert complain(raised.value) == code
