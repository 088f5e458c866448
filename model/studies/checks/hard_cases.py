"""Windows of counts that strain a classifier's arithmetic: flat, saturated, flickering, drifting, tiny."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, ROWS

Window = NDArray[np.float32]
FRAMES = 144
DRIFT_COUNTS = 300.0
DRIFT_FRAMES = round(3600 * FRAME_RATE_HZ)
DRIFT_STEPS = 7


@dataclass(frozen=True, eq=False)
class HardCase:
    """Windows (T, 8, 8) float32 of one kind."""

    name: str
    windows: tuple[Window, ...]


def hard_cases(longest: int) -> list[HardCase]:
    """Return all cases. longest: the longest window that the classifier accepts, in frames."""
    one_taxel = flat(0.0)
    one_taxel[:, 3, 4] = MAX_COUNT
    still = np.repeat(hand(1), FRAMES, axis=0)
    return [
        HardCase("a usual touch", (hand(FRAMES),)),
        HardCase("all zeros", (flat(0.0),)),
        HardCase("all 1023", (flat(MAX_COUNT),)),
        HardCase("one taxel at 1023", (one_taxel,)),
        HardCase("0/1023 checkerboard, flipping", (checkerboard(FRAMES),)),
        HardCase("constant frames", (still, flat(1.0), flat(500.0))),
        HardCase("offset drift over an hour", tuple(drift())),
        HardCase("the longest window", (hand(longest), checkerboard(longest), flat(MAX_COUNT, longest))),
        HardCase("a window of 1 frame", (hand(1), flat(0.0, 1), flat(MAX_COUNT, 1), checkerboard(1))),
        HardCase("tiny values", (tiny(),)),
    ]


def flat(count: float, frames: int = FRAMES) -> Window:
    """Return a window in which every taxel of every frame has the same count."""
    return np.full((frames, ROWS, COLUMNS), count, dtype=np.float32)


def checkerboard(frames: int) -> Window:
    """Return a window whose neighbours in space and time are 0 and 1023, the largest possible change."""
    t, row, column = np.indices((frames, ROWS, COLUMNS))
    return np.asarray((t + row + column) % 2 * MAX_COUNT, dtype=np.float32)


def hand(frames: int) -> Window:
    """Return a fingertip that circles and presses three times a second, with a few counts of noise."""
    t, row, column = np.indices((frames, ROWS, COLUMNS))
    angle = 2 * np.pi * t / FRAME_RATE_HZ
    distance = (row - 3.5 - 2 * np.sin(angle)) ** 2 + (column - 3.5 - 2 * np.cos(angle)) ** 2
    pressure = 300 * (1 + np.sin(3 * angle)) * np.exp(-distance / 2)
    noise = np.random.default_rng(0).integers(5, size=t.shape)
    return np.asarray(np.rint(pressure + noise), dtype=np.float32)


def drift() -> list[Window]:
    """Return the same touch at seven times of an hour in which the pad's offset rises."""
    starts = np.linspace(0, DRIFT_FRAMES - FRAMES, DRIFT_STEPS)
    frames = starts[:, None] + np.arange(FRAMES)  # (DRIFT_STEPS, FRAMES)
    offsets = np.rint(DRIFT_COUNTS * frames / DRIFT_FRAMES)[:, :, None, None]
    return list(np.minimum(hand(FRAMES) + offsets, MAX_COUNT).astype(np.float32))


def tiny() -> Window:
    """Return values of all denormal magnitudes, up to the smallest normal float."""
    # Made from bits, because arithmetic may flush denormals to zero.
    bits = np.logspace(0, 23, num=FRAMES * ROWS * COLUMNS, base=2).astype(np.uint32)
    return bits.view(np.float32).reshape(FRAMES, ROWS, COLUMNS)
