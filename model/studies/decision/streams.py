"""The network's answers at every frame of touches of people it never saw: the data of the stopping rules.

Each touching recording stands between notouch of the same participant and condition, as in
`touchd.model.studies.tracker.measure`. The daemon's own tracker finds the touch in it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.pipeline import PipelineSettings
from touchd.drivers.recording import NO_TOUCH, Recording
from touchd.model.classifier import Classifier, State
from touchd.model.studies.tracker.measure import LEAD_FRAMES, Case, feel, spliced
from touchd.model.training import haart
from touchd.model.training.ship import left_out_split

FRAMES = 144
# Rest is learned in half a second; more of the notouch would only take time.
REST_FRAMES = 60


@dataclass(frozen=True, eq=False)
class Streams:
    """N touches of at least FRAMES frames: the answers to each, and its true gesture.

    probabilities: (N, FRAMES, labels), after each frame of the touch. truth: (N,) places among the labels.
    noticed: (N,) frame of the touch at which it was noticed; nothing can be told before.
    """

    probabilities: NDArray[np.float32]
    truth: NDArray[np.int64]
    noticed: NDArray[np.int64]
    participants: NDArray[np.str_]
    labels: tuple[str, ...]

    @cached_property
    def named(self) -> NDArray[np.float32]:
        """The probabilities with "notouch", which is never told, set to zero."""
        named: NDArray[np.float32] = self.probabilities.copy()
        named[:, :, self.labels.index(NO_TOUCH)] = 0.0
        return named


def collect(recordings: Sequence[Recording], weights: Path) -> Streams:
    """Ask each left-out network about the touches of the people it never saw."""
    rows = []
    labels: tuple[str, ...] = ()
    for model, held in left_out_split(weights, haart.realigned(recordings)):
        labels = model.labels
        for case in spliced(held, level_rest=True):
            for noticed, said in _follow(case, model):
                rows.append((said, labels.index(case.gesture), noticed, case.participant))
    answers, truth, noticed_at, people = zip(*rows, strict=True)
    return Streams(np.stack(answers), np.array(truth), np.array(noticed_at), np.array(people), labels)


def collect_windows(recordings: Sequence[Recording], model: Classifier) -> Streams:
    """Ask a network about the challenge's windows of FRAMES frames, "notouch" among them."""
    windows = haart.cut(haart.realigned(recordings), FRAMES)
    states: list[State | None] = [None] * len(windows.labels)
    said = np.zeros((len(windows.labels), FRAMES, len(model.labels)), np.float32)
    for frame in range(FRAMES):
        heard = model.steps(list(windows.counts[:, frame : frame + 1]), states)
        said[:, frame] = [answer for answer, _ in heard]
        states = [state for _, state in heard]
    noticed = np.zeros(len(windows.labels), np.int64)
    return Streams(said, windows.labels, noticed, windows.participants, model.labels)


def _follow(case: Case, model: Classifier) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Yield when the case's first touch was noticed, and the answers; nothing when it was missed or short."""
    scans = case.scans[LEAD_FRAMES - REST_FRAMES : case.stop]
    felt = next(feel(scans, PipelineSettings().touch), None)
    if felt is None or felt.noticed < REST_FRAMES or felt.first + FRAMES > len(scans):
        return
    state, said = None, []
    for scan in scans[felt.first : felt.first + FRAMES]:
        answer, state = model.step(np.clip(np.rint(scan), 0, 1023)[None], state)
        said.append(answer)
    yield felt.noticed - felt.first, np.array(said, np.float32)
