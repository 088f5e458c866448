"""An audit of a pad's events, and a viewer of the live page."""

import math
import threading
from collections import deque

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from touchd.daemon.path.events import Event, Prediction, TouchBegan, TouchEnded, encode

# A touch this long has had its final answer; two frames allow for the median at its end.
FINAL_FRAMES = 144 + 2
LEAVE_S = 10.0
ORDER = {"early": 0, "revised": 1, "final": 2, "ongoing": 3, "released": 4, "uncertain": 4}


class Audit:
    """Checks a pad's events as they come: touches are numbered without a gap, and answered as documented.

    oldest_ms: the highest age at which an answer may be told. wrong: the events that broke a rule.
    """

    def __init__(self, oldest_ms: float = math.inf) -> None:
        self.touches = 0
        self.wrong: deque[str] = deque(maxlen=20)
        self._oldest_ms = oldest_ms
        self._answers: list[Prediction] | None = None
        self._told = "uncertain"

    @property
    def is_open(self) -> bool:
        """Whether a touch goes on."""
        return self._answers is not None

    def see(self, event: Event) -> None:
        """Take the next event."""
        match event:
            case TouchBegan():
                self._expect(not self.is_open and event.touch == self.touches + 1, event)
                self.touches = event.touch
                self._answers, self._told = [], "uncertain"
            case Prediction():
                self._expect(self.is_open and event.touch == self.touches, event)
                self._check_answer(event, self._answers[-1] if self._answers else None)
                self._answers = [*(self._answers or []), event]
            case TouchEnded():
                stages = [answer.stage for answer in self._answers or []]
                self._expect(event.touch == self.touches and self.is_open, event)
                is_final = "final" in stages or "uncertain" in stages
                self._expect(is_final or stages[-1:] == ["released"], event)
                self._expect(event.frames < FINAL_FRAMES or is_final, event)
                self._expect(event.gesture == self._told, event)
                self._expect((event.gesture == "uncertain") == (stages[-1:] == ["uncertain"]), event)
                self._answers = None

    def _check_answer(self, answer: Prediction, before: Prediction | None) -> None:
        """Check an answer's stage, what it says of a change, and whether it may be told."""
        if before is not None:
            again = before.stage == "released" or (
                answer.stage == "ongoing" and before.stage in ("ongoing", "uncertain")
            )
            self._expect(again or ORDER[answer.stage] > ORDER[before.stage], answer)
        if answer.stage != "uncertain":
            changed = before is None or answer.gesture != before.gesture
            self._expect(answer.changed == changed, answer)
        if answer.told:
            is_news = answer.gesture != self._told or answer.stage == "uncertain"
            self._expect(is_news and answer.gesture != "notouch", answer)
            self._expect(answer.age_ms <= self._oldest_ms, answer)
            self._told = answer.gesture

    def _expect(self, holds: bool, event: Event) -> None:
        if not holds:
            stages = [answer.stage for answer in self._answers or []]
            self.wrong.append(f"after {stages}: {encode(event).decode()}")


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
