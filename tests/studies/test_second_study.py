"""The parts of the second study's recordings that are trained on, and those that are scored."""

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

from docs.studies.training import second_study
from drivers.recording import Recording, ideal_clock_ms


def made(takes: int) -> Recording:
    counts = np.arange(540 * takes, dtype=np.uint16)[:, None, None] % 1000 + np.zeros((8, 8), np.uint16)
    return Recording("R02", "static", "none", "rub", counts, ideal_clock_ms(len(counts)), "live")


def test_each_take_is_trained_on_without_its_edges() -> None:
    takes = second_study.takes([made(1), made(2)])
    assert [len(take.counts) for take in takes] == [486] * 3
    assert [int(take.counts[0, 0, 0]) for take in takes] == [27, 27, 567]


def test_eight_seconds_of_the_first_take_are_scored() -> None:
    (scored,) = second_study.scored([made(2)])
    assert [int(scored.counts[i, 0, 0]) for i in (0, -1)] == [54, 485]
    assert len(scored.sensor_ms) == 432
