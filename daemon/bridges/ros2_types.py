"""The ROS 2 messages that are published, as DDS knows them: std_msgs/String and sensor_msgs/Image.

cyclonedds reads the annotations at run time, so `from __future__ import annotations` must not stand here.
"""

from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import int32, sequence, uint8, uint32

from daemon.bridges.bridge import arrival_s
from drivers.frame import COLUMNS, ROWS, Frame

BYTES_PER_TAXEL = 2


@dataclass
@final
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    """A text."""

    data: str


@dataclass
@final
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """A time since 1970."""

    sec: int32
    nanosec: uint32


@dataclass
@final
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """When, and on what."""

    stamp: Time
    frame_id: str


@dataclass
@final
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    """A picture."""

    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]  # type: ignore[type-arg]


def image(frame: Frame, pad: str) -> Image:
    """Return a frame as a mono16 picture, stamped with its time of arrival."""
    seconds, nanoseconds = divmod(round(arrival_s(frame) * 1e9), 1_000_000_000)
    return Image(
        header=Header(Time(seconds, nanoseconds), pad),
        height=ROWS,
        width=COLUMNS,
        encoding="mono16",
        is_bigendian=0,
        step=COLUMNS * BYTES_PER_TAXEL,
        data=frame.pressure.astype("<u2").tobytes(),  # type: ignore[arg-type]
    )
