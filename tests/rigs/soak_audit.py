"""Checks every event of the soak, and is a viewer of the live page that comes and goes."""

import threading
from collections import deque

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from daemon.events import Event, Prediction, TouchBegan, TouchEnded, encode

# A touch of this many frames has had its final answer; two to spare for the median that smooths its end.
FINAL_FRAMES = 144 + 2
LEAVE_S = 10.0


class Audit:
    """Checks every event: touches are numbered without a gap, each has its answers, and none twice."""

    def __init__(self) -> None:
        self.touches = self.predictions = self.events = 0
        self.wrong: deque[str] = deque(maxlen=20)
        self._stages: list[str] | None = None

    def see(self, event: Event) -> None:
        """Take the next event."""
        self.events += 1
        match event:
            case TouchBegan():
                self._expect(self._stages is None and event.touch == self.touches + 1, event)
                self.touches = event.touch
                self._stages = []
            case Prediction():
                stages = self._stages if self._stages is not None else []
                again = event.stage != "ongoing" and event.stage in stages
                self._expect(self._stages is not None and event.touch == self.touches and not again, event)
                stages.append(event.stage)
                self.predictions += 1
            case TouchEnded():
                stages = self._stages or [""]
                answered = "final" in stages or stages[-1] in ("released", "uncertain")
                long = event.frames >= FINAL_FRAMES
                self._expect(event.touch == self.touches and answered, event)
                self._expect(not long or "final" in stages, event)
                self._stages = None

    def _expect(self, holds: bool, event: Event) -> None:
        if not holds:
            self.wrong.append(f"after {self._stages}: {encode(event).decode()}")


class Viewer:
    """A viewer of the live page. seen: how many messages it received."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._thread: threading.Thread | None = None
        self._leaving = threading.Event()
        self.seen = 0

    def come(self) -> None:
        """Connect."""
        self._leaving.clear()
        self._thread = threading.Thread(target=self._look, name="viewer")
        self._thread.start()

    def leave(self) -> None:
        """Disconnect; may be repeated."""
        self._leaving.set()
        if self._thread is not None:
            self._thread.join(LEAVE_S)
            self._thread = None

    def _look(self) -> None:
        try:
            with connect(f"ws://127.0.0.1:{self._port}/stream", compression=None) as connection:
                while not self._leaving.is_set():
                    connection.recv()
                    self.seen += 1
        except ConnectionClosed:
            return
