"""Whether frames come closely enough: what is told when they do not, and when they do again."""

from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from touchd.daemon.timing import Feeling
from touchd.drivers.frame import Frame


def told(feeling: Feeling, times_ms: Iterable[int], clock_factor: int = 1) -> list[str]:
    said = []
    for number, (before_ms, ms) in enumerate(pairwise([-1000, *times_ms])):
        frame = Frame(number, ms * clock_factor, ms / 1000.0, np.zeros((8, 8), np.uint16))
        said.append(feeling.update(frame, restarted=(ms - before_ms) * clock_factor > 150))
    return [what for what in said if what is not None]


def test_a_pad_that_loses_frames_in_runs_is_not_told_to_mend_its_clock() -> None:
    # 20 of 30 frames arrive, at 54 Hz.
    times_ms = [round(1000 / 54 * i) for i in range(600) if i % 30 < 20]
    (why,) = told(Feeling(), times_ms)
    assert "gaps of up to 20" in why
    assert "frames lost on the way" in why
    assert "clock" not in why


def test_a_clock_that_does_not_count_milliseconds_is_blamed() -> None:
    (why,) = told(Feeling(), range(0, 10_000, 18), clock_factor=10)
    assert "54 frames a second" not in why
    assert "it must count milliseconds" in why


def test_a_degraded_pad_is_told_up_again() -> None:
    feeling = Feeling()
    assert len(told(feeling, range(0, 10_000, 200))) == 1
    assert told(feeling, range(10_200, 12_000, 18)) == [""]
