"""Which jumps of an untouched pad are taken for a loose wire."""

import numpy as np
import pytest
from numpy.typing import NDArray

from touchd.daemon.path.tracker.loose_wire import LOOK_FRAMES, LooseWire

Frames = NDArray[np.float32]
REST = np.full((8, 8), 3.0, np.float32)
HEIGHTS = np.array([5, 4, 12, 9, 2, 2, 4, 6], np.float32)
LITTLE = np.full(8, 1.4, np.float32)


def known_after(up: Frames, down: Frames | None = None, wire: LooseWire | None = None) -> LooseWire:
    """Return the detector after the pad jumped three times by `up`, and back by `down` (default: `up`)."""
    down = up if down is None else down
    levels = [REST]
    for _ in range(3):
        levels += [levels[-1] + up, levels[-1] + up - down]
    frames = np.repeat(np.array(levels), 27, axis=0).reshape(-1, 64)
    frames += np.random.default_rng(0).normal(0, 0.5, frames.shape).astype(np.float32)
    wire = wire or LooseWire()
    for stop in range(LOOK_FRAMES, len(frames), 6):
        seen = wire.take_out(frames[stop - LOOK_FRAMES : stop].reshape(-1, 8, 8), REST)
        wire.look(seen.reshape(-1, 64))
    return wire


def column(heights: Frames, number: int = 2) -> Frames:
    jump = np.zeros((8, 8), np.float32)
    jump[:, number] = heights
    return jump


def elsewhere(counts: float) -> Frames:
    jump = np.zeros((8, 8), np.float32)
    jump[6, 6] = counts
    return jump


@pytest.mark.parametrize(
    ("jump", "line"),
    [(column(HEIGHTS), "column 3"), (column(HEIGHTS, 7).T, "row 8"), (column(-HEIGHTS), "column 3")],
)
def test_a_line_that_jumps_and_returns_is_corrected(jump: Frames, line: str) -> None:
    wire = known_after(jump)
    assert wire.lines == (line,)
    assert wire.take_out(REST + jump, REST) == pytest.approx(REST, abs=2.0)


@pytest.mark.parametrize(
    ("up", "down"),
    [
        pytest.param(np.full((8, 8), 5.0, np.float32), None, id="the whole pad"),
        pytest.param(column(HEIGHTS) + 2.0, None, id="and the others, by less"),
        pytest.param(column(HEIGHTS) + elsewhere(9.0), None, id="and a taxel elsewhere"),
        pytest.param(column(HEIGHTS * (HEIGHTS > 5)), None, id="a fingertip"),
        pytest.param(column(LITTLE), None, id="by little"),
        pytest.param(column(HEIGHTS), column(3 * HEIGHTS[::-1]), id="by more and elsewhere on the way back"),
    ],
)
def test_other_jumps_are_not_a_loose_wire(up: Frames, down: Frames | None) -> None:
    assert known_after(up, down).lines == ()


def test_two_loose_wires_are_both_known() -> None:
    first = known_after(column(HEIGHTS))
    assert known_after(column(HEIGHTS, 5), wire=first).lines == ("column 3", "column 6")
