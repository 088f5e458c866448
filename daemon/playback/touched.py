"""The page of a simulated pad that its viewers touch."""

import json
import re
import socket
import threading
import time
from contextlib import suppress
from pathlib import Path

import msgspec
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from touchd.daemon.app.config import LiveSettings
from touchd.daemon.live.memory import Scene
from touchd.daemon.live.server import LiveServer
from touchd.daemon.live.touch import Touching
from touchd.daemon.path.events import Event, LivePrediction
from touchd.drivers.frame import DEFAULT_PAD, Counts, Frame

RETRY_S = 0.2
STOP_S = 1.0
# The line that a daemon with a page logs.
SERVED = re.compile(r"live page: http://(\S+)/")


class TouchPage:
    """The page of a simulated pad, served by this process.

    listening: the socket to serve. pad: the pad's scene; without a model the page shows the pad alone.
    """

    def __init__(self, listening: socket.socket, settings: LiveSettings, pad: Scene) -> None:
        self.touching = Touching()
        self._server = LiveServer(listening, settings, {DEFAULT_PAD: pad}, self.touching)
        self._stopping = threading.Event()

    def start(self) -> None:
        self._server.start()

    def stop(self) -> None:
        self._stopping.set()
        self._server.stop(STOP_S)

    def put(self, event: Event) -> None:
        self._server.put(event)

    def show_frame(self, counts: Counts, sensor_ms: int) -> None:
        self._server.put_frame(Frame(sensor_ms, time.monotonic(), counts), 0)

    def follow(self, log: Path) -> None:
        """Show the live predictions of a daemon with its own page, whose address is in its log."""
        threading.Thread(target=self._relay, args=(log,), name="touchd-relay", daemon=True).start()

    def _relay(self, log: Path) -> None:
        while not self._stopping.wait(RETRY_S):
            with suppress(OSError, WebSocketException):
                served = SERVED.search(log.read_text(errors="replace"))
                if served is None:
                    continue
                with connect(f"ws://{served[1]}/stream", compression=None) as viewer:
                    for message in viewer:
                        if self._stopping.is_set():
                            return
                        if isinstance(message, str) and json.loads(message)["type"] == "live_prediction":
                            self._server.put(msgspec.json.decode(message, type=LivePrediction))
