"""A sample of what a pad sends, and the result of a check."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from touchd.drivers.errors import one_line
from touchd.drivers.frame import Counts, Frame
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import Port, read_waiting

# Opening the port restarts an Arduino, whose boot loader takes two seconds.
START_S = 4.0
LATEST_BYTES = 65536
Verdict = Literal["ok", "warning", "to do", "not checked"]


@dataclass(frozen=True)
class Check:
    """The result of one check. found: in words for the user.

    verdict: "ok"; "warning" (touchd copes); "to do" (does not work, or not well, until `advice` is
    followed); "not checked" (`found` says why).
    """

    name: str
    verdict: Verdict
    found: str
    advice: str = ""

    def __post_init__(self) -> None:
        # It may contain a robot's answer, which may span lines.
        object.__setattr__(self, "found", one_line(self.found))


@dataclass(frozen=True, eq=False)
class Sample:
    """What a pad sent while the doctor listened.

    frames: in order. damaged: frames refused as damaged after the first intact one. data: the latest bytes,
    at most LATEST_BYTES. ended_s: when listening ended, `time.monotonic()`. clipped: the share of frames with
    values above full scale.
    """

    frames: tuple[Frame, ...]
    damaged: int
    data: bytes
    ended_s: float
    clipped: float = 0.0

    def counts(self) -> Counts:
        """Return the pressure of all frames, (T, 8, 8) uint16."""
        return np.stack([frame.pressure for frame in self.frames])


def listen(
    opened: Port,
    parser: FrameParser,
    seconds: float,
    start_s: float = START_S,
    enough: Callable[[Frame], bool] = lambda frame: False,
) -> Sample:
    """Listen for `seconds` after the first frame; without one, after the first bytes.

    start_s: how long the first bytes may take. enough: ends listening at a frame if true. Raises SensorError
    when the port goes away.
    """
    frames: list[Frame] = []
    latest, damaged_before, is_enough = b"", 0, False
    now_s = time.monotonic()
    until_s = now_s + start_s
    while not is_enough and now_s < until_s:
        data = read_waiting(opened, parser)
        now_s = time.monotonic()
        arrived = parser.feed(data, now_s)
        if (data and not latest) or (arrived and not frames):
            until_s, damaged_before = now_s + seconds, parser.counts.bad
        frames += arrived
        latest = (latest + data)[-LATEST_BYTES:]
        is_enough = any(map(enough, arrived))
    damaged = parser.counts.bad - damaged_before if frames else 0
    clipped = parser.counts.clipped / max(parser.counts.frames, 1)
    return Sample(tuple(frames), damaged, latest, now_s, clipped)
