"""How fast frames came, and how many were lost, by the pad's own clock."""

from collections.abc import Sequence

import numpy as np
import pytest

from touchd.drivers.frame import CLOCK_MODULUS, Frame
from touchd.drivers.pad.pace import clock_ms, pace_of

STEP_MS = 19
NOTHING = np.zeros((8, 8), np.uint16)


def frames_at(stamps: Sequence[int]) -> list[Frame]:
    return [Frame(ms % CLOCK_MODULUS, 0.0, NOTHING) for ms in stamps]


def test_frames_lost_in_a_gap_are_counted() -> None:
    pace = pace_of(frames_at([5000 + STEP_MS * number for number in range(20) if number not in (8, 9, 10)]))
    assert pace.lost == 3
    assert pace.rate_hz == pytest.approx(1000 / STEP_MS)
    assert pace.jitter_ms == 0.0


def test_a_clock_that_wraps_continues() -> None:
    stamps = [CLOCK_MODULUS - 100 + STEP_MS * number for number in range(20)]
    assert clock_ms(frames_at(stamps)).tolist() == stamps
    assert pace_of(frames_at(stamps)).lost == 0


def test_a_clock_that_restarts_continues_by_the_usual_step() -> None:
    stamps = [5000 + STEP_MS * number for number in range(20)]
    frames = frames_at([*stamps[:10], *range(0, 10 * STEP_MS, STEP_MS)])
    assert clock_ms(frames).tolist() == stamps
