"""A live page: of the spawned daemon on a fake pad, or served in this process; for the tests of it."""

import http.client
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rigs.patient_port import PATIENT
from rigs.sockets import free_port
from rigs.wait import AT_ONCE_S, WITHIN_S, wait_for
from websockets.sync.client import ClientConnection, connect

from daemon.config import LiveSettings, SensorSettings, Settings
from daemon.events import Event
from daemon.live.messages import encode_frame
from daemon.live.server import LiveServer
from daemon.playback.rig import SpawnedDaemon
from daemon.setup.destinations import open_live_page
from daemon.setup.parts import load_model
from drivers.frame import DEFAULT_PAD, Counts, Frame
from model.classifier import Classifier

SERVED = re.compile(r"live page: (http://\S+)/")
IN_ALL = re.compile(r"(\d+) frames, (\d+) touches, (\d+) frames dropped in all")
HANDSHAKE = (
    "GET /stream HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dG91Y2hkdG91Y2hkdG91Yw==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


class LiveDaemon:
    """A daemon that serves its page on loopback, at `port` (0: any that is free), and reads `pad`."""

    def __init__(self, pad: str, folder: Path, port: int = 0) -> None:
        settings = Settings(sensor=SensorSettings(port=pad), live=LiveSettings(port=port), scene=PATIENT)
        self._log_path = folder / "log"
        self._log = self._log_path.open("wb")
        self._daemon = SpawnedDaemon(settings, folder, self._log)
        self.process = self._daemon.process
        self.events: list[Event] = []
        self._reader = threading.Thread(target=self._collect)
        self._reader.start()
        self.url = self._await_url()

    @property
    def port(self) -> int:
        return int(self.url.rpartition(":")[2])

    @property
    def log(self) -> str:
        return self._log_path.read_text()

    def in_all(self) -> tuple[int, int, int]:
        """Frames, touches and dropped frames that it reported at its end."""
        said = IN_ALL.search(self.log)
        assert said is not None, self.log
        return int(said[1]), int(said[2]), int(said[3])

    def kill(self) -> None:
        """Kill it, as a power cut would."""
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        if self.process.poll() is None:
            self.process.terminate()
        code = self.process.wait(WITHIN_S)
        self._reader.join()
        self._daemon.stop()
        self._log.close()
        return code

    def _collect(self) -> None:
        for event in self._daemon.events():
            self.events.append(event)

    def _await_url(self) -> str:
        def served() -> re.Match[str] | None:
            assert self.process.poll() is None, self.log
            return SERVED.search(self.log)

        return wait_for(served)[1]  # type: ignore[index]


@contextmanager
def live_daemon(pad: str, folder: Path, port: int = 0) -> Iterator[LiveDaemon]:
    daemon = LiveDaemon(pad, folder, port)
    try:
        yield daemon
    finally:
        daemon.stop()


class Served:
    """A page served in this process, and frames to show on it."""

    def __init__(self, classifier: Classifier, **settings: Any) -> None:
        self.port = free_port()
        self.settings = Settings(live=LiveSettings(port=self.port), **settings)
        self.models = dict.fromkeys(self.settings.pads, classifier)
        self.sink = self.serve(self.settings)
        self._frames = 0

    def serve(self, settings: Settings, before: LiveServer | None = None) -> LiveServer:
        """A started page."""
        server = open_live_page(settings, self.models, before)
        assert server is not None
        server.start()
        return server

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
        frame = Frame(self._frames, 18 * self._frames, 0.0, counts)
        self.sink.put_frame(frame, 0, pad)
        return encode_frame(frame)

    def ask(self, path: str = "/", **headers: str) -> http.client.HTTPResponse:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=WITHIN_S)
        connection.request("GET", path, headers=headers)
        return connection.getresponse()


@contextmanager
def serving(**settings: Any) -> Iterator[Served]:
    """A served page; stopped and checked to leave nothing at the end."""
    served = Served(load_model(Settings()), **settings)
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
