"""Decides which answer to a touch is reported, and when it is revised."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.daemon.path.events import UNCERTAIN, Stage
from touchd.drivers.frame import FRAME_RATE_HZ, NO_TOUCH, OTHER

Probability = Annotated[float, msgspec.Meta(ge=0, le=1)]
FrameCount = Annotated[int, msgspec.Meta(ge=1, le=432)]

# A gesture has changed when the log odds of another one against the told one have risen by this; smaller
# probabilities count as the least one. With 6, 2 % more changes are told, and 1 % more false ones.
CHANGED_LOG_ODDS = 6.5
LEAST_PROBABILITY = 0.01

# The confidence from which an answer is sure one second into a touch. An earlier answer needs more and a
# later one less, because waiting helps less and less (docs/decision.md).
SURE = 0.7
SURE_FALLS = 0.2
# The final answer, and the answer to an ended touch, are told from these confidences on. They are lower than
# speak_above, as waiting helps no more; docs/decision.md has their curves.
FINAL_ABOVE = 0.4
# How much more probable another gesture must be to replace the told one.
REVISE_MARGIN = 0.1
# Weight of "notouch" in the answer to an ended touch, which the tracker has followed from first to last
# contact. With full weight, 1 % more of light touches are not named.
ENDED_NOTOUCH = 0.15


def answerable(gestures: Sequence[str], labels: Sequence[str]) -> tuple[str, ...]:
    """Return the labels that a scene's answers may name, in the labels' order; no gestures mean all."""
    named = {*(gestures or labels), OTHER} - {NO_TOUCH}
    return tuple(label for label in labels if label in named)


def sure_above(confidence: float, frames: int) -> float:
    """Return the confidence from which an answer is sure after `frames`. confidence: the same after 54."""
    return confidence + SURE_FALLS * math.log(FRAME_RATE_HZ / frames)


class DecisionSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One scene: which gestures can occur, when to answer, and how sure to be; see touchd.example.yaml.

    The defaults were measured: docs/decision.md. "notouch" and "other" can always occur.
    """

    gestures: tuple[str, ...] = ()
    answer_at_frames: tuple[FrameCount, FrameCount, FrameCount] = (54, 81, 144)
    early: Literal["at_mark", "when_sure"] = "at_mark"
    speak_above: Probability = 0.65
    final_above: Probability = FINAL_ABOVE
    stale_s: Annotated[float, msgspec.Meta(ge=0.001, le=60)] = 2.0

    def __post_init__(self) -> None:
        early, revised, final = self.answer_at_frames
        if not early < revised < final:
            raise ValueError(f"answer_at_frames {self.answer_at_frames} must rise from early to final")


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer at one stage; the fields are those of `touchd.daemon.path.events.Prediction`."""

    stage: Stage
    gesture: str
    confidence: float
    probabilities: dict[str, float]
    changed: bool
    told: bool
    perhaps: str = ""


class Decision:
    """One touch: which answer stands, what the robot was told, and when to tell it.

    Until an answer is told, the most probable gesture stands. It is told once its probability reaches the
    stage's limit. A told answer is replaced only by a gesture that is now more probable by REVISE_MARGIN
    and reaches that limit too; otherwise it stands, and is not told again. "notouch" may stand, but it is
    never told and never replaces a told answer. A touch without a told gesture is answered as "uncertain",
    once, at its final answer or at its end; a later answer that is sure replaces it.
    """

    def __init__(
        self, settings: DecisionSettings, labels: tuple[str, ...], revise_margin: float = REVISE_MARGIN
    ) -> None:
        self._settings = settings
        self._revise_margin = revise_margin
        self._labels = labels
        occurs = {*answerable(settings.gestures, labels), NO_TOUCH}
        self._occurs = [label in occurs for label in labels]
        self._ended = np.where([label == NO_TOUCH for label in labels], ENDED_NOTOUCH, 1.0)
        self.may_be_early = settings.early == "when_sure"
        self._stands: str | None = None
        self._answered: dict[str, float] = {}
        self.told: str | None = None

    @property
    def is_answered(self) -> bool:
        """Whether a gesture was told, or the touch answered as "uncertain"."""
        return self.told is not None or self._stands == UNCERTAIN

    def answer(self, stage: Stage, probabilities: NDArray[np.float64], *, may_tell: bool = True) -> Answer:
        """Return the answer to (labels,) calibrated probabilities at a stage.

        The answer's stage becomes "uncertain" if no gesture was told before and this one is not sure enough
        for "final" or "released". At "uncertain", for a touch that ended with nothing told, it always is.
        may_tell: False when it is too late to tell. An "ongoing" answer is reported, and stands, only if it
        is told.
        """
        has_ended = stage in ("released", "uncertain")
        scene = self.weigh(probabilities * self._ended if has_ended else probabilities)
        best = _likeliest(scene)
        may_tell = may_tell and best != NO_TOUCH
        tell = may_tell and self._is_told(stage, best, scene)
        if not tell and self._is_doubt(stage, best, scene):
            # A touch without a name is told, unless the model sees no touch at all.
            self._stands, self._answered = UNCERTAIN, scene
            perhaps = "" if best == NO_TOUCH else best
            return Answer("uncertain", UNCERTAIN, scene[best], scene, True, may_tell, perhaps)
        stands = best if tell or self.told is None else self.told
        changed = stands != self._stands
        if stage != "ongoing" or tell:
            self._stands, self._answered = stands, scene
        self.told = stands if tell else self.told
        return Answer(stage, stands, scene[stands], scene, changed, tell)

    def _is_told(self, stage: Stage, best: str, scene: dict[str, float]) -> bool:
        """Whether the most probable gesture is told: a first answer, or one that beats the told one."""
        if stage == "uncertain" or scene[best] < self._limit(stage):
            return False
        return self.told is None or (
            best != self.told and scene[best] - scene[self.told] >= self._revise_margin
        )

    def _is_doubt(self, stage: Stage, best: str, scene: dict[str, float]) -> bool:
        """Whether an answer that is not told becomes "uncertain", at the last mark or the end of a touch."""
        if stage == "final" and self.told is None:
            return best != NO_TOUCH and scene[best] < self._limit(stage)
        return stage == "uncertain" or (stage == "released" and self.told is None)

    def is_sure_of_released(self, probabilities: NDArray[np.float64], *, is_over: bool) -> bool:
        """Whether to answer a touch whose hand has left. is_over: whether the touch has likely ended."""
        scene = self.weigh(probabilities * self._ended if is_over else probabilities)
        best, limit = _likeliest(scene), self._limit("released" if is_over else "early")
        return self.told is None and best != NO_TOUCH and scene[best] >= limit

    def has_changed(self, probabilities: NDArray[np.float64]) -> bool:
        """Whether a touch's latest frames show another gesture than the last answer: (labels,) probabilities.

        A high probability is not enough: the last answer may have been wrong, so the odds must have shifted.
        Without a told gesture it is enough.
        """
        now = self.weigh(probabilities)
        if self.told is None:
            return _likeliest(now) != NO_TOUCH
        pair = (_likeliest(now), self.told)
        odds = []
        for scene in (now, self._answered):
            likely, other = (max(scene.get(label, 0.0), LEAST_PROBABILITY) for label in pair)
            odds.append(likely / other)
        return math.log(odds[0] / odds[1]) >= CHANGED_LOG_ODDS

    def is_sure(self, probabilities: NDArray[np.float64], frames: int) -> bool:
        """Whether to answer early now, `frames` into the touch; False for an answer that may not be told."""
        scene = self.weigh(probabilities)
        best = _likeliest(scene)
        limit = max(sure_above(SURE, frames), self._settings.speak_above)
        return best != NO_TOUCH and scene[best] >= limit

    def _limit(self, stage: Stage) -> float:
        """Return the confidence from which an answer is told at a stage."""
        settings = self._settings
        return settings.final_above if stage in ("final", "released") else settings.speak_above

    def weigh(self, probabilities: NDArray[np.float64]) -> dict[str, float]:
        """Return (labels,) probabilities by label, renormalised over the gestures that can occur."""
        kept = [p if occurs else 0.0 for p, occurs in zip(probabilities.tolist(), self._occurs, strict=True)]
        if not any(kept):
            kept = [float(occurs) for occurs in self._occurs]
        total = sum(kept)
        return {label: value / total for label, value in zip(self._labels, kept, strict=True)}


def _likeliest(scene: dict[str, float]) -> str:
    return max(scene, key=lambda label: scene[label])
