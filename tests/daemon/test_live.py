"""The live page's server: viewers get every event, and none of them slows the daemon."""

import asyncio
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import msgspec
import pytest
from rigs.live_rig import HANDSHAKE, Served, frames_among, serving
from rigs.made_events import PREDICTION, TIME
from rigs.wait import SOON_S, WITHIN_S
from websockets.asyncio import client, server
from websockets.sync.client import ClientConnection

from touchd.daemon.app.config import Settings
from touchd.daemon.commands.settings import load_model
from touchd.daemon.live.memory import PREDICTIONS, TOUCHES, Memory, Scene
from touchd.daemon.live.server import CAPACITY, LiveServer
from touchd.daemon.live.viewers import Viewers
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


def test_a_stalled_viewer_does_not_affect_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    # It answers no ping while it reads nothing, which takes a busy machine longer than usual.
    monkeypatch.setattr("touchd.daemon.live.server.PING_EVERY_S", WITHIN_S)
    narrow = socket.socket()
    narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
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


def test_a_viewer_far_behind_gets_the_state_instead_of_events() -> None:
    state, events = "state", [f"{number:09}" + "x" * 10_000 for number in range(200)]

    async def of_a_slow_viewer() -> list[str | bytes]:
        viewers = Viewers(lambda: [state])

        async def looks(viewer: server.ServerConnection) -> None:
            assert viewers.add(viewer)
            for event in events:
                viewers.tell(event)
            while viewer.transport.get_write_buffer_size():
                await asyncio.sleep(0.01)
            viewers.tell("last")
            await viewer.wait_closed()

        narrow = socket.create_server(("127.0.0.1", 0))
        narrow.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        url = f"ws://127.0.0.1:{narrow.getsockname()[1]}"
        async with server.serve(looks, sock=narrow, compression=None), client.connect(url) as slow:
            got = [await asyncio.wait_for(slow.recv(), SOON_S)]
            while len(got) == 1 or got[-1] not in ("last", state):
                got.append(await asyncio.wait_for(slow.recv(), SOON_S))
            return got

    first, *told, last = asyncio.run(of_a_slow_viewer())
    assert (first, last) == (state, state)
    assert told == events[: len(told)]
    assert 0 < len(told) < len(events)


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
    assert [message for message in viewer if isinstance(message, bytes)] == []
