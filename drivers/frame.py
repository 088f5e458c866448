"""The items that a pad's reader delivers: frames, the pad's state, and what a parser refused."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

ROWS = 8
COLUMNS = 8
MAX_COUNT = 1023
FRAME_RATE_HZ = 54.0
MIN_RATE_HZ = 8.0
"""With fewer frames a second, touches are not recognised: init, doctor and run say so."""
CLOCK_MODULUS = 2**32
"""The sensor's clock, in ms, wraps to 0 here."""
DEFAULT_PAD = "pad"
"""The name of the only pad, if the configuration gives it none."""
NO_TOUCH = "notouch"
"""The label of frames in which nothing touches the pad."""
OTHER = "other"
"""The label of a touch that is none of the gestures that the network knows."""

Counts = NDArray[np.uint16]
PadState: TypeAlias = Literal["up", "degraded", "down"]


class Frame(msgspec.Struct, frozen=True, eq=False):
    """One complete scan of the pad.

    sensor_ms: the sensor's own clock in milliseconds (uint32, wraps after 49.7 days); after a restart of the
    board it goes on.
    host_s: `time.monotonic()` when the frame's last byte arrived, in seconds.
    pressure: (8, 8) uint16 counts, 0 (no pressure) to 1023, read-only.
    """

    sensor_ms: int
    host_s: float
    pressure: Counts


def ms_between(earlier_ms: int, later_ms: int) -> int:
    """Return the ms from one time of the sensor's clock, which wraps, to another; negative if backwards."""
    half = CLOCK_MODULUS // 2
    return (later_ms - earlier_ms + half) % CLOCK_MODULUS - half


@dataclass
class ProtocolCounts:
    """What a parser delivered and refused since it was made.

    frames: delivered. damaged: about how many frames the refused bytes were. bad_time: frames refused because
    they disagree with the pad's clock. duplicates: frames that repeat a clock already taken. clipped: frames
    delivered whose values above full scale were cut to it. restarts: of the board.
    """

    frames: int = 0
    damaged: int = 0
    bad_time: int = 0
    duplicates: int = 0
    clipped: int = 0
    restarts: int = 0

    @property
    def bad(self) -> int:
        """Frames refused as damaged, for whatever reason; a duplicate is not damage."""
        return self.damaged + self.bad_time


@dataclass(frozen=True)
class SensorState:
    """The state of a pad: "up", "degraded" (frames come, but not every touch is recognised) or "down".

    reason: one line for people. cause: identifies the cause, whatever the reason's wording.
    """

    state: PadState
    reason: str
    cause: str = ""
