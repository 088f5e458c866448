"""The live page's server: viewers get every event, and none of them slows the daemon."""

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import msgspec
import numpy as np
import pytest
from rigs.live_rig import HANDSHAKE, Served, frames_among, serving
from rigs.made_events import PREDICTION, TIME
from rigs.wait import WITHIN_S, wait_for
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection

from touchd.daemon.app.config import Settings
from touchd.daemon.commands.settings import load_model
from touchd.daemon.live import viewers
from touchd.daemon.live.memory import PREDICTIONS, TOUCHES, Memory, Scene
from touchd.daemon.live.server import CAPACITY, LiveServer
from touchd.daemon.path.events import SensorEvent, TouchBegan, TouchEnded, encode

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
    assert caplog.text == ""


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
