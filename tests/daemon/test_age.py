"""The age of frames, by the pad's clock and the host's."""

import numpy as np
import pytest

from daemon.pad.age import Age
from drivers.pad.grid import GridFrame


def test_a_lasting_delay_is_forgotten_within_fifty_times_its_length() -> None:
    age = Age()

    def played(first_s: float, last_s: float, late_s: float) -> float:
        for pad_s in np.arange(first_s, last_s, 1 / 54):
            frame = GridFrame(0, 1000.0 * pad_s, pad_s + late_s, np.zeros((8, 8), np.float32), False, False)
            age.update(frame)
        return age.of(frame, frame.host_s)

    assert played(0.0, 2.0, 0.0) == pytest.approx(0.0, abs=1e-6)
    assert played(2.0, 7.0, 1.0) == pytest.approx(0.9, abs=0.01)
    assert played(7.0, 60.0, 1.0) == pytest.approx(0.0, abs=1e-6)
