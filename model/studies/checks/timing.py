"""Answer times, measured in turn in one run, so that other load on the machine affects all alike."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.progress import track

IN_A_ROW = 10
"""Answers of one before the next is asked: most then run from warm caches, and p99 shows the cold ones."""


@dataclass(frozen=True)
class Timing:
    """How long one of `answers` took: on the clock, and the median of this thread's processor time.

    A busy machine stretches the first and not the second; to compare by the second, all work must be done by
    the thread that asks.
    """

    answers: int
    p50_ms: float
    p99_ms: float
    processor_ms: float


def time_in_turn(asked: Sequence[Callable[[], object]], answers: int) -> list[Timing]:
    """Ask all in turn, IN_A_ROW times each, until each has given `answers`."""
    clock_s = np.empty((len(asked), answers))
    processor_s = np.empty((len(asked), answers))
    turns = range(0, answers, IN_A_ROW)
    for first in track(turns, description="timing", console=Console(stderr=True), transient=True):
        for row, answer in enumerate(asked):
            for column in range(first, min(first + IN_A_ROW, answers)):
                start_s, start_processor_s = time.perf_counter(), time.thread_time()
                answer()
                processor_s[row, column] = time.thread_time() - start_processor_s
                clock_s[row, column] = time.perf_counter() - start_s
    p50_ms, p99_ms = 1000.0 * np.percentile(clock_s, [50, 99], axis=1)
    processor_ms = 1000.0 * np.median(processor_s, axis=1)
    return [
        Timing(answers, float(p50_ms[row]), float(p99_ms[row]), float(processor_ms[row]))
        for row in range(len(asked))
    ]
