"""Runs several pads side by side and batches equal requests to the network."""

from collections import defaultdict
from collections.abc import Generator, Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from touchd.model.classifier import Classifier, State

Heard: TypeAlias = tuple[NDArray[np.float64], State]


@dataclass(frozen=True)
class Step:
    """A request to the network: (T, 8, 8) new frames of a touch, from the state after its first `given`."""

    model: Classifier
    frames: NDArray[np.float32]
    state: State | None
    given: int


Work: TypeAlias = Generator[Step, Heard, None]
"""Work that asks the network on its way."""


def work_off(works: Iterable[Work]) -> None:
    """Do all work; each keeps its own order."""
    todo: list[tuple[Work, Heard | None]] = [(work, None) for work in works]
    while todo:
        alike: defaultdict[tuple[int, int, int], list[tuple[Work, Step]]] = defaultdict(list)
        for work, heard in todo:
            with suppress(StopIteration):
                step = next(work) if heard is None else work.send(heard)
                alike[id(step.model), step.given, len(step.frames)].append((work, step))
        todo = []
        for asked in alike.values():
            steps = [step for _, step in asked]
            heards = steps[0].model.steps([step.frames for step in steps], [step.state for step in steps])
            todo += zip((work for work, _ in asked), heards, strict=True)
