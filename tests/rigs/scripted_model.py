"""A model with scripted answers."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from touchd.model.classifier import ModelState
from touchd.model.detector import DetectorState

LABELS = ("constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle")


class Scripted:
    """A model that gives one gesture a probability of 0.94, chosen by the number of windows asked so far.

    labels: what it knows. "other" is not among the default ones, as in a lab's own file.

    asked: the whole windows it was asked about. stepped: at each step, the touch's frames up to then.
    """

    name = "scripted"
    metadata = SimpleNamespace(training={})

    def __init__(
        self, gesture: Callable[[int], str] = lambda asked: "stroke", labels: tuple[str, ...] = LABELS
    ) -> None:
        self.labels = labels
        self._gesture = gesture
        self.asked: list[NDArray[np.float32]] = []
        self.stepped: list[NDArray[np.float32]] = []

    def probabilities(self, frames: NDArray[np.float32]) -> NDArray[np.float64]:
        self.asked.append(frames)
        return self.answer()

    def step(
        self, frames: NDArray[np.float32], state: ModelState | None
    ) -> tuple[NDArray[np.float64], ModelState]:
        so_far = frames if state is None else np.concatenate([state["counts"], frames])
        self.stepped.append(so_far)
        return self.answer(), {"counts": so_far}

    def answer(self) -> NDArray[np.float64]:
        return self._sure_of(self._gesture(len(self.asked)))

    def _sure_of(self, gesture: str) -> NDArray[np.float64]:
        return np.array([0.94 if label == gesture else 0.01 for label in self.labels])


class PressureDetector:
    """A detector that sees a hand where nine taxels read five counts above rest on average, and no other."""

    training: ClassVar[dict[str, Any]] = {}

    def begin(self, frames: NDArray[np.float32]) -> DetectorState:
        rest = np.sort(frames, axis=0)[len(frames) // 2]
        noise = np.abs(np.diff(frames, axis=0)).mean(axis=0) / 1.128
        return {
            "levels": np.stack([rest, rest, rest])[None],
            "noise": noise[None, None],
            "hidden": np.zeros((1, 1), np.float32),
        }

    def step(
        self, counts: NDArray[np.float32], state: DetectorState, *, is_touch: bool
    ) -> tuple[float, DetectorState]:
        above = np.sort(counts - state["levels"][0, 0])[-9:]
        return float(above.mean() > 5.0), state
