"""What the robot is told about a touch, and the form in which its memory can hold it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from touchd.drivers.frame import DEFAULT_PAD


@dataclass(frozen=True, slots=True)
class RobotMessage:
    """One answer to what a touch was.

    gesture: a label of the model, or "uncertain". confidence: 0 to 1. time_s: seconds since 1970.
    stage: early, revised, final, released, ongoing or uncertain.
    touch: number of the touch on its pad since the daemon started. sequence: number of the message.
    pad: where it was. feel: what the touch was like so far, by the names in `touchd.daemon.pad.feel`.
    """

    gesture: str
    confidence: float
    time_s: float
    stage: str
    touch: int
    sequence: int
    pad: str = DEFAULT_PAD
    feel: Mapping[str, float | None] = field(default_factory=dict)


def detail(message: RobotMessage) -> list[object]:
    """Return [gesture, confidence, [seconds, microseconds], stage, touch, sequence] in builtin types.

    ALMemory holds 4-byte integers and floats: an epoch time as a float would be good to 128 s only, so it
    goes as two integers. Integers wrap at 2**31.
    """
    seconds, microseconds = divmod(round(float(message.time_s) * 1_000_000), 1_000_000)
    return [
        str(message.gesture),
        float(message.confidence),
        [_int32(seconds), microseconds],
        str(message.stage),
        _int32(message.touch),
        _int32(message.sequence),
    ]


def _int32(number: int) -> int:
    return int(number) & 0x7FFF_FFFF
