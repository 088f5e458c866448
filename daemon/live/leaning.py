"""What the model makes of a touch between two answers: for the eye alone, and out of the daemon's way."""

from __future__ import annotations

from collections import deque

import numpy as np

from daemon.decide import Decision
from daemon.events import Event, TouchBegan, TouchEnded
from daemon.live.memory import Scene
from daemon.live.messages import Leaning
from daemon.touch import LEARN_FRAMES
from drivers.frame import Frame
from drivers.pad.grid import CLOCK_WRAP_MS, GridFrame, Ring

# Six times a second. Answers fall due at whole multiples of these, so that asking half way between two leaves
# the processor to them.
STRIDE_FRAMES = 9
OFFSET_FRAMES = 4
# Less than a quarter of a second says next to nothing.
FEWEST_FRAMES = 13


class Leanings:
    """Follows a touch on a ring of its own, as the pipeline does, and asks the model now and then."""

    def __init__(self, scene: Scene) -> None:
        self.change(scene)

    def change(self, scene: Scene) -> None:
        """Go by another scene from now on; the touch that goes on is no longer asked about."""
        self._scene = scene
        self._longest = scene.settings.decision.answer_at_frames[-1]
        self._ring = Ring(scene.settings.ring, capacity=1)
        self._frames: deque[GridFrame] = deque(maxlen=self._longest + LEARN_FRAMES)
        self._touch: TouchBegan | None = None
        self._first_index: int | None = None

    def put(self, event: Event) -> None:
        """Take note of a touch that begins or ends."""
        if isinstance(event, TouchBegan):
            self._touch, self._first_index = event, None
        elif isinstance(event, TouchEnded):
            self._touch = None

    def push(self, frame: Frame, may_ask: bool = True) -> Leaning | None:
        """Take the next frame; return what the model makes of the touch, if it is time to ask and one may."""
        laid = self._ring.push(frame)
        if not laid:
            return None
        if laid[0].restarted:
            # A gap in the line, or nobody looked: the touch that goes on is not all here.
            self._touch = None
            self._frames.clear()
        self._frames.extend(laid)
        if self._touch is None:
            return None
        if self._first_index is None:
            self._first_index = self._find(self._touch.sensor_ms)
        if self._first_index is None:
            return None
        length = self._frames[-1].index + 1 - self._first_index
        is_due = length >= FEWEST_FRAMES and length % STRIDE_FRAMES == OFFSET_FRAMES
        return self._ask(self._touch, length) if is_due and may_ask else None

    def _find(self, sensor_ms: int) -> int | None:
        """Return the index of the frame with which the touch began; None when it came before we looked."""
        for laid in self._frames:
            if round(laid.sensor_ms) % CLOCK_WRAP_MS == sensor_ms:
                return laid.index
        return None

    def _ask(self, touch: TouchBegan, length: int) -> Leaning:
        window = list(self._frames)[-min(length, self._longest) :]
        probabilities = self._scene.model.probabilities(np.stack([laid.pressure for laid in window]))
        # A decision of its own, for how it weighs the scene's gestures; what it would say is not said.
        answer = Decision(self._scene.settings.decision, self._scene.model.labels).answer(
            "ongoing", probabilities
        )
        weighed = {label: round(value, 4) for label, value in answer.probabilities.items()}
        return Leaning(touch=touch.touch, frames=length, probabilities=weighed, pad=touch.pad)
