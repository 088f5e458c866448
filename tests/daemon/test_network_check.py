"""The network is asked about an untouched pad only when what the pad reads has changed."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.made_pad import MadePad, Scans, nothing, palm

from touchd.daemon.tracker.network_check import ASK_FRAMES, NetworkCheck
from touchd.daemon.tracker.tracker import GLANCE_FRAMES


def times_asked(pressure: Scans, p_no_touch: float = 0.9) -> int:
    """Return how often the network is asked about these frames, after a second of rest."""
    frames = MadePad().counts(np.concatenate([nothing(1.0), pressure])).reshape(-1, 64).astype(np.float32)
    asked: list[NDArray[np.float32]] = []

    def ask(window: NDArray[np.float32]) -> float:
        asked.append(window)
        return p_no_touch

    check = NetworkCheck(ask)
    for stop in range(54, len(frames) + 1, ASK_FRAMES):
        check.begins_touch(frames[stop - GLANCE_FRAMES : stop])
    return len(asked)


def test_a_pad_that_reads_as_before_is_not_asked_about_again() -> None:
    assert times_asked(nothing(10.0)) <= 3


@pytest.mark.parametrize(
    "pressure",
    [np.linspace(0, 10, 540)[:, None, None] * palm(10.0, 1.0, False), palm(10.0)],
    ids=["rising", "a hand"],
)
def test_a_pad_that_reads_otherwise_is_asked_about(pressure: Scans) -> None:
    assert times_asked(pressure) >= 8


def test_an_answer_that_saw_a_touch_is_asked_for_again() -> None:
    assert times_asked(nothing(10.0), p_no_touch=0.1) == 31
