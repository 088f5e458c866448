"""The lab's second study as training and test data: the same pad and gestures, wrapped around a robot.

Source: Cang et al., "Different Strokes and Different Folks" (ICMI 2015), study 2, in our recording layout.
Each recording holds a gesture several times over, ten seconds each, end to end.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.recording import Recording, ideal_clock_ms, read_recordings
from touchd.model.training.haart import PUBLISHED_FRAMES, find

FILES = ("robot-pad.csv", "robot-pad-more.csv")
TAKE_FRAMES = round(10 * FRAME_RATE_HZ)
SCORED_FROM = round(FRAME_RATE_HZ)
"""As in HAART, the middle 8 of 10 s of each recording's first take are scored."""
EDGE_FRAMES = round(0.5 * FRAME_RATE_HZ)
"""Cut from both ends of a take in training, where the hand comes and goes."""


def read(folder: Path) -> list[Recording]:
    """Read the 373 recordings as they are stored."""
    hint = "name its folder: --second-study"
    return [recording for name in FILES for recording in read_recordings(find(folder, name, hint))]


def takes(recordings: Iterable[Recording]) -> list[Recording]:
    """Return every take as a separate recording, without its edges, to train on.

    The takes of L1 and L2 lack their last frame, so that only the part that is used must be whole.
    """
    return [
        _part(recording, start + EDGE_FRAMES, start + TAKE_FRAMES - EDGE_FRAMES)
        for recording in recordings
        for start in range(0, len(recording.counts) - TAKE_FRAMES + EDGE_FRAMES + 1, TAKE_FRAMES)
    ]


def scored(recordings: Iterable[Recording]) -> list[Recording]:
    """Return the 8 s of every recording that are scored, as long as HAART's."""
    return [_part(recording, SCORED_FROM, SCORED_FROM + PUBLISHED_FRAMES) for recording in recordings]


def _part(recording: Recording, start: int, stop: int) -> Recording:
    counts = recording.counts[start:stop]
    return replace(recording, counts=counts, sensor_ms=ideal_clock_ms(len(counts)))
