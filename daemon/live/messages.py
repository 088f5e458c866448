"""Messages to the page: the daemon's events unchanged, frames, state and status.

All but frames are JSON. A frame has 133 bytes, little-endian, its sensor_ms (uint32), 64 counts (uint16), and
the pad's place in `PageState.pads` (uint8).
"""

import struct

import msgspec

from daemon.events import RobotAction, RobotEvent, SensorEvent
from daemon.kept.touches import ReportedTouch
from drivers.frame import Frame

CLOCK = struct.Struct("<I")
CLOCK_MASK = 0xFFFFFFFF


class PageState(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", tag="state"):
    """What a page needs when it connects, or has fallen behind.

    pad: of which of the pads. page: stamp of the page's files; a page with another reloads. labels: in the
    order of the probabilities. answer_at_frames, speak_above, revise_margin: of the scene. model: its name.
    names: of the gestures, in the page's language. action: the robot's latest action on the last touch.
    touches: the last ones, oldest first; an ongoing touch comes last.
    """

    page: str
    pad: str
    pads: tuple[str, ...]
    labels: tuple[str, ...]
    answer_at_frames: tuple[int, ...]
    frame_rate_hz: float
    model: str
    speak_above: float
    revise_margin: float
    language: str
    names: dict[str, str]
    robot_configured: bool
    action: RobotAction | None
    sensor: SensorEvent | None
    robot: RobotEvent | None
    touches: tuple[ReportedTouch, ...]


class Status(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", tag="status"):
    """The status, sent twice a second. rate_hz: frame rate. dropped: frames dropped under overload."""

    rate_hz: float
    dropped: int
    viewers: int
    pad: str


def encode_frame(frame: Frame, pad: int = 0) -> bytes:
    """Return a frame in the page's format. pad: the index of its pad."""
    return CLOCK.pack(frame.sensor_ms & CLOCK_MASK) + frame.pressure.astype("<u2").tobytes() + bytes([pad])


def encode_message(message: msgspec.Struct) -> str:
    return msgspec.json.encode(message).decode()
