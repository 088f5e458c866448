"""The state of the live page, for viewers who connect later."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.app.config import Settings
from touchd.daemon.path.decide import REVISE_MARGIN
from touchd.daemon.path.events import (
    UNCERTAIN,
    Event,
    Label,
    Prediction,
    RobotAction,
    RobotEvent,
    SensorEvent,
    TouchBegan,
    TouchEnded,
)
from touchd.daemon.robot.words import SHIPPED, Vocabulary, name_of, words_of
from touchd.daemon.sinks.touches import ReportedTouch
from touchd.drivers.frame import CLOCK_MODULUS, FRAME_RATE_HZ, NO_TOUCH, Frame
from touchd.model.classifier import Classifier

TOUCHES = 40
PREDICTIONS = 24
# The curve of a touch that a later viewer gets: its first 15 seconds, every third frame.
TRACE_FRAMES = 810
TRACE_STEP = 3
# Four seconds: a touch is detected within one, and rest is measured in the second before it.
RECENT_FRAMES = 216
# The pad's rest is the mean of the REST_MS that end ONSET_MS before a touch's first frame.
REST_MS, ONSET_MS = 1000, 100
# As on the page.
NOISE_COUNTS = 3.0


class Scene(NamedTuple):
    """The scene of a pad's page. settings: those of this pad alone. model: None if nothing is recognised."""

    settings: Settings
    model: Classifier | None


class Memory:
    """A pad's last touches with their answers, recent frames, the last state of pad and robot; bounded."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._sensor: SensorEvent | None = None
        self._robot: RobotEvent | None = None
        self._action: RobotAction | None = None
        self._touches: deque[ReportedTouch] = deque(maxlen=TOUCHES)
        self._said: dict[int, str] = {}
        self._reported: deque[int] = deque(maxlen=TOUCHES)
        self._recent: deque[Frame] = deque(maxlen=RECENT_FRAMES)
        self._traced: list[Frame] = []
        self._rest: NDArray[np.float64] | None = None

    def put_frame(self, frame: Frame) -> None:
        """Remember a frame; the only method for another thread."""
        self._recent.append(frame)
        if len(self._traced) < TRACE_FRAMES:
            self._traced.append(frame)

    def put(self, event: Event) -> None:
        """Remember an event, unless its touch began before we listened."""
        match event:
            case SensorEvent():
                self._sensor = event
            case RobotEvent():
                self._robot = event
            case RobotAction():
                self._action = event
            case TouchBegan():
                self._action = None
                self._touches.append(ReportedTouch(event))
                self._said = {touch: said for touch, said in self._said.items() if self.find(touch)}
                self._rest = self._rest_before(event.sensor_ms)
                self._traced = list(self._recent.copy())
            case Label() if self.find(event.touch):
                self._said[event.touch] = event.gesture
            case Prediction() | TouchEnded() if self._touches:
                is_told = isinstance(event, Prediction) and event.told
                if is_told and self._robot is not None and self._robot.state == "up":
                    self._reported.append(event.touch)
                self._touches[-1].add(event)
                del self._touches[-1].predictions[:-PREDICTIONS]

    @property
    def rate_hz(self) -> float:
        """Recent frames per second, 0 without any."""
        recent = self._recent.copy()
        span_s = recent[-1].host_s - recent[0].host_s if recent else 0.0
        return round((len(recent) - 1) / span_s, 1) if span_s > 0.0 else 0.0

    def find(self, touch: int) -> TouchBegan | None:
        """Return the beginning of a touch that the page shows; None if it shows no such touch."""
        return next((one.began for one in self._touches if one.began.touch == touch), None)

    def _rest_before(self, began_ms: int) -> NDArray[np.float64] | None:
        """Return the mean of each taxel just before a touch, None without frames of that time."""
        before = [
            frame.pressure
            for frame in self._recent.copy()
            if ONSET_MS < (began_ms - frame.sensor_ms) % CLOCK_MODULUS <= ONSET_MS + REST_MS
        ]
        return np.mean(before, axis=0) if before else None

    def _trace(self) -> tuple[tuple[float, float], ...]:
        """Return the ongoing touch's curve: seconds since it began, and counts above rest."""
        if self._rest is None or not self._traced or not self._touches or self._touches[-1].ended:
            return ()
        frames = self._traced[::TRACE_STEP]
        began_ms = self._touches[-1].began.sensor_ms
        since_ms = np.array([(frame.sensor_ms - began_ms) % CLOCK_MODULUS for frame in frames])
        pressed = np.array([frame.pressure for frame in frames]) - self._rest - NOISE_COUNTS
        loads = np.maximum(pressed, 0.0).sum(axis=(1, 2))
        # Modulo the clock's range, a frame from before the touch lies almost a whole turn ahead.
        return tuple(
            (ms / 1000, round(load, 1))
            for ms, load in zip(since_ms.tolist(), loads.tolist(), strict=True)
            if ms < CLOCK_MODULUS // 2
        )

    def state(self, page: str, pad: str, pads: Sequence[str], touchable: bool = False) -> dict[str, object]:
        """Return what a page gets when it connects or has fallen far behind.

        page: stamp of the page's files; a page with another stamp reloads. pad: the name of this pad.
        touchable: whether viewers can touch the pad.
        """
        settings, model = self.scene
        scene, labels = settings.scene, model.labels if model else ()
        trace, words = self._trace(), words_of(settings)
        return {
            "type": "state",
            "page": page,
            "pad": pad,
            "pads": pads,
            # In the order of the probabilities.
            "labels": labels,
            "answer_at_frames": scene.answer_at_frames,
            "frame_rate_hz": FRAME_RATE_HZ,
            "model": model.name if model else "",
            "speak_above": scene.speak_above,
            "revise_margin": REVISE_MARGIN,
            "names": {label: name_of(words, label) for label in (*labels, UNCERTAIN)},
            # The words for each gesture when nothing is sure.
            "guesses": {label: _guess(words, label) for label in set(labels) - {NO_TOUCH}},
            "robot_configured": settings.robot is not None,
            "action": self._action,
            "sensor": self._sensor,
            "robot": self._robot if settings.robot else None,
            # The oldest first; an ongoing touch comes last.
            "touches": list(self._touches),
            # Touches that the robot was told about while it was up.
            "reported": list(self._reported),
            # Each taxel's reading before an ongoing touch, and that touch's curve.
            "rest": self._rest.round(1).ravel().tolist() if self._rest is not None and trace else (),
            "trace": trace,
            "touchable": touchable,
            "may_label": settings.live is not None and settings.live.label,
            "said": self._said,
        }


def _guess(words: Vocabulary, gesture: str) -> str:
    """Return the words for an unsure gesture; only touchd's own English goes into an English sentence."""
    name = name_of(words, gesture)
    shipped_name, phrase = SHIPPED["en"].get(gesture, ("", ""))
    return f"{phrase[0].upper()}{phrase[1:]}, perhaps?" if name == shipped_name else f"{name}?"
