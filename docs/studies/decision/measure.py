"""How early and how often the daemon is right: spliced HAART touches through its own pipeline.

Each touching recording of a training participant stands between notouch of the same participant and condition
(see `docs.studies.tracker.measure`), and is answered by a network that never saw the participant. Its answer
at each stage is kept, so that every setting of the decision is tried on the same answers.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daemon.decide import Decision, DecisionSettings
from daemon.events import Event, Prediction, Stage, TouchBegan
from daemon.pipeline import STAGES, Pipeline, PipelineSettings
from docs.studies.tracker.measure import Case
from drivers.frame import FRAME_RATE_HZ, MAX_COUNT, Frame
from drivers.recording import ideal_clock_ms
from model.classifier import Classifier


@dataclass(frozen=True, eq=False)
class Said:
    """The network's answers to one touch: probabilities (labels,) at each stage, in order."""

    gesture: str
    participant: str
    answers: tuple[tuple[Stage, float, NDArray[np.float64]], ...]
    """Stage, seconds since the touch began, probabilities."""


@dataclass(frozen=True)
class Told:
    """What the robot was told of one touch: seconds since it began, and whether it was right, each time."""

    stages: tuple[Stage, ...]
    elapsed_s: tuple[float, ...]
    right: tuple[bool, ...]

    @property
    def harmed(self) -> bool:
        """Whether a right answer was replaced by a wrong one."""
        return any(before and not after for before, after in zip(self.right, self.right[1:], strict=False))

    @property
    def settled_s(self) -> float | None:
        """When the first right answer that stayed was told; None when the last was wrong."""
        if not self.right or not self.right[-1]:
            return None
        wrong = [place for place, right in enumerate(self.right) if not right]
        return self.elapsed_s[wrong[-1] + 1 if wrong else 0]


def listen(cases: Sequence[Case], model: Classifier) -> Iterator[Said]:
    """Yield what the model said of each case's first touch; nothing for a touch that was missed."""
    for case in cases:
        events = _play(case, model)
        began = [event for event in events if isinstance(event, TouchBegan)]
        first_ms = case.start * 1000.0 / FRAME_RATE_HZ
        touch = next((event.touch for event in began if event.sensor_ms >= first_ms - 100), None)
        answers = tuple(
            (event.stage, event.elapsed_s, np.array([event.probabilities[label] for label in model.labels]))
            for event in events
            if isinstance(event, Prediction) and event.touch == touch and event.stage in (*STAGES, "released")
        )
        if answers:
            yield Said(case.gesture, case.participant, answers)


def decide(said: Said, settings: DecisionSettings, labels: tuple[str, ...]) -> Told:
    """Return what the robot would have been told under these settings."""
    decision = Decision(settings, labels)
    heard = []
    for stage, elapsed_s, probabilities in said.answers:
        answer = decision.answer(stage, probabilities)
        if answer.told:
            heard.append((stage, elapsed_s, answer.gesture == said.gesture))
    return Told(
        tuple(stage for stage, _, _ in heard),
        tuple(at for _, at, _ in heard),
        tuple(ok for _, _, ok in heard),
    )


def _play(case: Case, model: Classifier) -> list[Event]:
    events: list[Event] = []
    pipeline = Pipeline(PipelineSettings(), model, events.append)
    counts = np.clip(np.rint(case.scans), 0, MAX_COUNT).astype(np.uint16)
    for number, sensor_ms in enumerate(ideal_clock_ms(len(counts)).tolist()):
        pipeline.on_frame(Frame(number, sensor_ms, 0.0, counts[number]))
    pipeline.flush()
    return events
