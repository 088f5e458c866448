"""What to say about a touch, and when to change one's mind."""

from __future__ import annotations

import typing
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

NO_TOUCH = "notouch"

Probability = Annotated[float, msgspec.Meta(ge=0, le=1)]
FrameCount = Annotated[int, msgspec.Meta(ge=1, le=432)]


class ProbabilityModel(typing.Protocol):
    """What the pipeline asks of a classifier; `model.classifier.Classifier` is one."""

    @property
    def labels(self) -> tuple[str, ...]:
        """The gestures, in the order of the probabilities."""
        ...

    @property
    def name(self) -> str:
        """What the model is called in events."""
        ...

    def probabilities(self, frames: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return calibrated probabilities, shape (labels,), for counts of shape (T, 8, 8) at 54 Hz."""
        ...


class DecisionSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One scene: which gestures can occur, when to answer, and how sure to be.

    gestures: those that can occur; empty means all the model knows. "notouch" always can, named or not.
    answer_at_frames: length of the touch when early, revised and final answer are due (54 a second).
    speak_above: calibrated confidence from which the robot is told before the final answer.
    revise_margin: an answer the robot has heard is replaced only by one more probable than it by this much.
    """

    gestures: tuple[str, ...] = ()
    answer_at_frames: tuple[FrameCount, FrameCount, FrameCount] = (54, 81, 144)
    speak_above: Probability = 0.6
    revise_margin: Probability = 0.15

    def __post_init__(self) -> None:
        early, revised, final = self.answer_at_frames
        if not early < revised < final:
            raise ValueError(f"answer_at_frames {self.answer_at_frames} must rise from early to final")
