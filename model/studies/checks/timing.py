"""Measures processor time of answers by turns in one run, so that other load affects them equally."""

import time
from collections.abc import Callable, Sequence

import numpy as np
from rich.console import Console
from rich.progress import track

IN_A_ROW = 10
"""Calls of one answer before the next answer's turn; most then run with warm caches."""


def time_in_turn(asked: Sequence[Callable[[], object]], answers: int) -> list[float]:
    """Call each function IN_A_ROW times, by turns, `answers` times in all; return the medians in ms.

    Only this thread's processor time counts, so all work must be done by the calling thread.
    """
    processor_s = np.empty((len(asked), answers))
    turns = range(0, answers, IN_A_ROW)
    console = Console(stderr=True)
    for first in track(
        turns, description="timing", console=console, transient=True, disable=not console.is_terminal
    ):
        for row, answer in enumerate(asked):
            for column in range(first, min(first + IN_A_ROW, answers)):
                start_s = time.thread_time()
                answer()
                processor_s[row, column] = time.thread_time() - start_s
    return [float(median) for median in 1000.0 * np.median(processor_s, axis=1)]
