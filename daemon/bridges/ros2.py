"""Publishes ROS 2 messages over DDS, without a ROS installation.

cyclonedds reads the annotations at run time, so do not use `from __future__ import annotations` here.
"""

import logging
import socket
import time
from dataclasses import dataclass
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from touchd.daemon.bridges.bridge import IMAGE, BridgeError, arrival_s
from touchd.daemon.path.events import Event, Prediction, encode
from touchd.drivers.faults import FaultLog
from touchd.drivers.frame import Frame
from touchd.drivers.hosts import own_addresses

# How often to check whether the network has changed.
CHECK_S = 5.0

# The defaults of rclpy and rclcpp. A reliable writer suits reliable and best-effort readers.
QOS = Qos(
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.Durability.Volatile,
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


@dataclass
@final
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    """A text: std_msgs/String."""

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
    """The time of an image, and the pad that it shows."""

    stamp: Time
    frame_id: str


@dataclass
@final
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    """A picture: sensor_msgs/Image."""

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
    header = Header(Time(seconds, nanoseconds), pad)
    pixels: Any = frame.pressure.astype("<u2").tobytes()
    return Image(header=header, **IMAGE, data=pixels)


class Ros2Outlet:
    """Publishes gesture (a String, told ones only), event (JSON in a String) and pressure (an Image).

    domain: ROS_DOMAIN_ID. name: of the robot.
    Raises BridgeError when this computer has no network, or its addresses have changed.
    """

    def __init__(self, domain: int, name: str, pad: str) -> None:
        # DDS chooses a network when it starts.
        self._addresses, self._checked_s = set(own_addresses()), time.monotonic()
        self._faults = FaultLog(logging.getLogger(__name__))
        try:
            participant = DomainParticipant(domain, Qos(Policy.EntityName(f"touchd_{socket.gethostname()}")))
        except DDSException as error:
            raise BridgeError(f"no network for DDS ({str(error).splitlines()[0]})") from error
        publisher = Publisher(participant)
        # ROS 2 prefixes the names of its DDS topics with rt.
        prefix = f"rt/{name}/{pad}"

        self._gesture, self._event, self._pressure = (
            DataWriter(publisher, Topic(participant, f"{prefix}/{what}", kind), QOS)
            for what, kind in (("gesture", String), ("event", String), ("pressure", Image))
        )
        self._pad = pad

    def send_event(self, event: Event) -> None:
        if isinstance(event, Prediction) and event.told:
            self._write(self._gesture, String(event.gesture))
        self._write(self._event, String(encode(event).decode()))

    def send_frame(self, frame: Frame) -> None:
        self._write(self._pressure, image(frame, self._pad))

    def _write(self, writer: DataWriter[IdlStruct], message: IdlStruct) -> None:
        if time.monotonic() - self._checked_s > CHECK_S:
            self._checked_s = time.monotonic()
            if set(own_addresses()) != self._addresses:
                raise BridgeError("the network has changed")
        try:
            writer.write(message)
        # For example, a reader accepts nothing.
        except DDSException as error:
            self._faults.begin("refused", f"a message was refused ({str(error).splitlines()[0]})")
