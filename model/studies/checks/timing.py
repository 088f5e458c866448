"""Measures the processor time of several answers, interleaved, so that other load affects them equally."""

import time
from collections.abc import Callable, Sequence

import numpy as np
from rich.console import Console
from rich.progress import track

IN_A_ROW = 10
"""Consecutive calls of one answer; most then run with warm caches."""


def time_interleaved(asked: Sequence[Callable[[], object]], answers: int) -> list[float]:
    """Call the functions in rotation, IN_A_ROW times each, up to `answers` times; return the medians in ms.

    Only this thread's processor time counts, so all work must be done by the calling thread.
    """
    processor_s = np.empty((len(asked), answers))
    rounds = range(0, answers, IN_A_ROW)
    console = Console(stderr=True)
    for first in track(
        rounds, description="timing", console=console, transient=True, disable=not console.is_terminal
    ):
        for row, answer in enumerate(asked):
            for column in range(first, min(first + IN_A_ROW, answers)):
                start_s = time.thread_time()
                answer()
                processor_s[row, column] = time.thread_time() - start_s
    return [float(median) for median in 1000.0 * np.median(processor_s, axis=1)]
