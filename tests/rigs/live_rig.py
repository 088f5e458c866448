"""A live page served in this process, and its viewers."""

import http.client
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
from rigs.wait import AT_ONCE_S, WITHIN_S
from websockets.sync.client import ClientConnection, connect

from touchd.daemon.app.config import LiveSettings, Settings
from touchd.daemon.app.parts import load_model
from touchd.daemon.live.server import LiveServer, encode_frame
from touchd.daemon.path.events import Event
from touchd.daemon.sinks.labels import Labeller
from touchd.drivers.frame import DEFAULT_PAD, Counts, Frame
from touchd.model.classifier import Classifier

HANDSHAKE = (
    "GET /stream HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dG91Y2hkdG91Y2hkdG91Yw==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


class Served:
    """A page served in this process, and frames to show on it.

    label: whether viewers may label touches. labels: those that they have given.
    """

    def __init__(self, classifier: Classifier, *, label: bool = False, **settings: Any) -> None:
        made = Settings(live=LiveSettings(port=0, label=label), **settings)
        self.models = dict.fromkeys(made.pads, classifier)
        self.labels: list[Event] = []
        labeller = Labeller(self._take, dict.fromkeys(made.pads, classifier.labels), are_saved=True)
        self.sink = LiveServer(made, self.models, labeller=labeller if label else None)
        self.sink.start()
        self.port = self.sink.listening.getsockname()[1]
        self._frames = 0

    def _take(self, label: Event) -> None:
        self.labels.append(label)
        self.sink.put(label)

    @contextmanager
    def look(self, **options: Any) -> Iterator[ClientConnection]:
        """A viewer."""
        with connect(f"ws://127.0.0.1:{self.port}/stream", compression=None, **options) as viewer:
            yield viewer

    def put_frame(self, counts: Counts | None = None, pad: str = DEFAULT_PAD) -> bytes:
        """Put a frame, a new one unless counts are given; return the message that a viewer gets."""
        self._frames += 1
        if counts is None:
            counts = np.full((8, 8), self._frames % 1024, np.uint16)
        frame = Frame(18 * self._frames, time.monotonic(), counts)
        self.sink.put_frame(frame, 0, pad)
        return encode_frame(frame)

    def ask(self, path: str = "/", **headers: str) -> http.client.HTTPResponse:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=WITHIN_S)
        connection.request("GET", path, headers=headers)
        return connection.getresponse()


@cache
def _model() -> Classifier:
    return load_model(Settings())


@contextmanager
def serving(**settings: Any) -> Iterator[Served]:
    """Yield a served page; afterwards no thread of it is left."""
    served = Served(_model(), **settings)
    try:
        yield served
    finally:
        served.sink.stop(AT_ONCE_S)
    assert "touchd-live" not in [thread.name for thread in threading.enumerate()]


def frames_among(viewer: ClientConnection, wanted: bytes) -> list[str | bytes]:
    """Return all messages up to and including the wanted frame."""
    got: list[str | bytes] = []
    while wanted not in got:
        got.append(viewer.recv(timeout=WITHIN_S))
    return got
