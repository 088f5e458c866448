"""The daemon's events, one JSON object a line, on stdout and in the journal: see docs/events.md."""

from datetime import datetime, timezone
from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import UNSET, UnsetType

from touchd.daemon.path.feel import Feel
from touchd.drivers.frame import DEFAULT_PAD, PadState

Stage: TypeAlias = Literal["early", "revised", "final", "released", "ongoing", "uncertain"]
ActionKind: TypeAlias = Literal["say", "animated_say", "behavior", "leds"]
EndReason: TypeAlias = Literal["released", "settled", "longest", "gap", "sensor", "stopped"]
# The largest integers that all readers of JSON keep exactly.
Count: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=2**53)]

# Values that the experimenter sets, by key; see `daemon.sinks.tags`. Without any, events lack the field.
Tags: TypeAlias = dict[str, str] | UnsetType

UNCERTAIN = "uncertain"
MAX_REASON_BYTES = 400


class TouchBegan(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", tag="touch_began"):
    """A hand is on the pad. touch: the number of the touch on its pad since the daemon started, from 1."""

    touch: Count
    time: str
    sensor_ms: Count
    pad: str = DEFAULT_PAD
    tags: Tags = UNSET


class Prediction(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", tag="prediction"):
    """The answer to a touch so far."""

    touch: Count
    stage: Stage
    frames: Count
    elapsed_s: float
    gesture: str
    confidence: float
    probabilities: dict[str, float]
    changed: bool
    told: bool
    degraded: bool
    latency_ms: float
    model: str
    time: str
    pad: str = DEFAULT_PAD
    age_ms: float = 0.0
    feel: Feel | None = None
    perhaps: str = ""
    tags: Tags = UNSET


class LivePrediction(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", tag="live_prediction"):
    """The model's current probabilities for a touch of this length in frames, for viewers; not an event."""

    touch: Count
    frames: Count
    probabilities: dict[str, float]
    pad: str = DEFAULT_PAD


class TouchEnded(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", tag="touch_ended"):
    """A touch has ended. sensor_ms: the sensor's clock at its last contact."""

    touch: Count
    gesture: str
    frames: Count
    reason: EndReason
    time: str
    sensor_ms: Count | None = None
    pad: str = DEFAULT_PAD
    feel: Feel | None = None
    tags: Tags = UNSET


class SensorEvent(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", tag="sensor"):
    """The pad came, went, or sends frames in which not every touch is recognised ("degraded")."""

    state: PadState
    time: str
    reason: str = ""
    pad: str = DEFAULT_PAD
    tags: Tags = UNSET


class RobotEvent(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", tag="robot"):
    """The robot came or went."""

    state: Literal["up", "down"]
    time: str
    reason: str = ""
    tags: Tags = UNSET


class RobotAction(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", tag="robot_action"):
    """The robot begins to do something about a touch."""

    touch: Count
    action: ActionKind
    what: str
    time: str
    pad: str = DEFAULT_PAD
    tags: Tags = UNSET


class Label(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", tag="label"):
    """What a touch was, from a person; of several labels of a touch the last holds.

    began: the time of the touch's `touch_began`, as numbers begin with 1 again after a restart.
    """

    touch: Count
    began: str
    gesture: str
    time: str
    pad: str = DEFAULT_PAD
    tags: Tags = UNSET


Event: TypeAlias = TouchBegan | Prediction | TouchEnded | SensorEvent | RobotEvent | RobotAction | Label


def encode(event: Event) -> bytes:
    """Return the event as one line of JSON, UTF-8, without a newline."""
    return msgspec.json.encode(event)


def timestamp(epoch_s: float) -> str:
    """Return seconds since 1970 as the `time` of an event: UTC, ISO 8601, whole milliseconds."""
    moment = datetime.fromtimestamp(round(epoch_s, 3), timezone.utc)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def epoch_s(time: str) -> float:
    """Return an event's `time` as seconds since 1970."""
    return datetime.fromisoformat(time.replace("Z", "+00:00")).timestamp()
