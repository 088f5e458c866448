"""The state of the live page, for viewers who connect later."""

from collections import deque

import numpy as np

from touchd.daemon.app.config import Settings
from touchd.daemon.path.decide import REVISE_MARGIN
from touchd.daemon.path.events import UNCERTAIN, Event, Prediction, TouchBegan
from touchd.daemon.robot.words import SHIPPED, Vocabulary, name_of, words_of
from touchd.daemon.sinks.touches import TOUCHES, Latest
from touchd.drivers.frame import FRAME_RATE_HZ, NO_TOUCH, Frame
from touchd.model.classifier import Classifier

# Two seconds: a touch is detected within one, so the first second shows the pad's rest.
RECENT_FRAMES = 108


class Memory(Latest):
    """What a viewer who connects later gets: the latest of a pad, and its recent frames.

    settings: those of this pad alone. model: None if nothing is recognised.
    """

    def __init__(self, settings: Settings, model: Classifier | None) -> None:
        super().__init__()
        self._settings = settings
        self._model = model
        self._reported: deque[int] = deque(maxlen=TOUCHES)
        self._recent: deque[Frame] = deque(maxlen=RECENT_FRAMES)
        self._rest: list[float] = []

    def put_frame(self, frame: Frame) -> None:
        """Remember a frame; the only method for another thread."""
        self._recent.append(frame)

    def put(self, event: Event) -> None:
        super().put(event)
        match event:
            case TouchBegan() if before := list(self._recent.copy())[: RECENT_FRAMES // 2]:
                self._rest = np.mean([frame.pressure.ravel() for frame in before], axis=0).tolist()
            case Prediction(told=True) if self.robot and self.robot.state == "up":
                self._reported.append(event.touch)

    @property
    def rate_hz(self) -> float:
        """Recent frames per second, 0 without any."""
        recent = self._recent.copy()
        span_s = recent[-1].host_s - recent[0].host_s if recent else 0.0
        return round((len(recent) - 1) / span_s, 1) if span_s > 0.0 else 0.0

    def state(self) -> dict[str, object]:
        """Return what a page receives about this pad when it connects or has fallen far behind."""
        settings, model = self._settings, self._model
        scene, labels = settings.scene, model.labels if model else ()
        words = words_of(settings)
        return {
            # In the order of the probabilities.
            "labels": labels,
            "answer_at_frames": scene.answer_at_frames,
            "frame_rate_hz": FRAME_RATE_HZ,
            "model": model.name if model else "",
            "speak_above": scene.speak_above,
            "revise_margin": REVISE_MARGIN,
            "names": {label: name_of(words, label) for label in (*labels, UNCERTAIN)},
            # How the page words each gesture while the answer is unsure.
            "guesses": {label: _guess(words, label) for label in set(labels) - {NO_TOUCH}},
            "robot_configured": settings.robot is not None,
            "action": self.action,
            "sensor": self.sensor,
            "robot": self.robot if settings.robot else None,
            # The oldest first; an ongoing touch comes last.
            "touches": list(self.touches),
            # Touches that the robot was told about while it was up.
            "reported": list(self._reported),
            # Each taxel's reading before the last touch.
            "rest": self._rest,
            "may_label": settings.live is not None and settings.live.label,
            "said": self.labels,
        }


def _guess(words: Vocabulary, gesture: str) -> str:
    """Return the words for an unsure gesture; only touchd's own English phrases fit an English sentence."""
    name = name_of(words, gesture)
    shipped_name, phrase = SHIPPED["en"].get(gesture, ("", ""))
    return f"{phrase[0].upper()}{phrase[1:]}, perhaps?" if name == shipped_name else f"{name}?"
