"""How early and how often the daemon is right: spliced HAART touches through its own pipeline.

Each touching recording of a training participant stands between notouch of the same participant and condition
(see `studies.tracker.measure`), and is answered by a network that never saw the participant. Its answer
at each stage is kept, so that every setting of the decision is tried on the same answers.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, takewhile

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.decide import Decision, DecisionSettings
from touchd.daemon.events import Prediction, Stage, TouchBegan
from touchd.daemon.pipeline import STAGES
from touchd.drivers.frame import FRAME_RATE_HZ, MAX_COUNT
from touchd.model.classifier import Classifier
from touchd.model.studies.play import frames_of, play
from touchd.model.studies.tracker.measure import Case


@dataclass(frozen=True, eq=False)
class Said:
    """The network's answers to one touch: probabilities (labels,) at each stage, in order."""

    gesture: str
    answers: tuple[tuple[Stage, float, NDArray[np.float64]], ...]
    """Stage, seconds since the touch began, probabilities."""


@dataclass(frozen=True)
class Told:
    """What the robot was told of one touch: stage, seconds since it began, and whether it was right."""

    answers: tuple[tuple[Stage, float, bool], ...]

    @property
    def right(self) -> list[bool]:
        """Whether it was right, each time."""
        return [right for *_, right in self.answers]

    @property
    def harmed(self) -> bool:
        """Whether a right answer was replaced by a wrong one."""
        return any(before and not after for before, after in pairwise(self.right))

    @property
    def settled_s(self) -> float | None:
        """When the first right answer that stayed was told; None when the last was wrong."""
        stayed = [at_s for _, at_s, _ in takewhile(lambda answer: answer[2], reversed(self.answers))]
        return stayed[-1] if stayed else None


def listen(cases: Sequence[Case], model: Classifier) -> Iterator[Said]:
    """Yield what the model said of each case's first touch; nothing for a touch that was missed."""
    for case in cases:
        counts = np.clip(np.rint(case.scans), 0, MAX_COUNT).astype(np.uint16)
        events = play(frames_of(counts), model, flush=True)
        first_ms = case.start * 1000.0 / FRAME_RATE_HZ - 100
        began = (event for event in events if isinstance(event, TouchBegan))
        touch = next((event.touch for event in began if event.sensor_ms >= first_ms), None)
        answers = tuple(
            (event.stage, event.elapsed_s, np.array([event.probabilities[label] for label in model.labels]))
            for event in events
            if isinstance(event, Prediction) and event.touch == touch and event.stage in (*STAGES, "released")
        )
        if answers:
            yield Said(case.gesture, answers)


def decide(said: Said, settings: DecisionSettings, labels: tuple[str, ...]) -> Told:
    """Return what the robot would have been told under these settings."""
    decision = Decision(settings, labels)
    answers = ((stage, at_s, decision.answer(stage, odds)) for stage, at_s, odds in said.answers)
    return Told(
        tuple((stage, at_s, answer.gesture == said.gesture) for stage, at_s, answer in answers if answer.told)
    )
