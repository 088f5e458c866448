"""Publishes ROS 2 messages over DDS, without a ROS installation.

cyclonedds reads the annotations at run time, so do not use `from __future__ import annotations` here.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from touchd.daemon.bridges.bridge import Bridge, Item, arrival_s, own_name
from touchd.daemon.bridges.settings import Ros2Settings
from touchd.daemon.live.own_addresses import own_addresses
from touchd.daemon.path.events import Prediction, encode
from touchd.drivers.faults import Backoff
from touchd.drivers.frame import COLUMNS, ROWS, Frame

BYTES_PER_TAXEL = 2
# DDS chooses a network when it starts. Interval of checks for a change, and pauses of retries without one.
LOOK_S = 5.0
FIRST_RETRY_S, LONGEST_RETRY_S = 1.0, 10.0

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
    return Image(
        header=Header(Time(seconds, nanoseconds), pad),
        height=ROWS,
        width=COLUMNS,
        encoding="mono16",
        is_bigendian=0,
        step=COLUMNS * BYTES_PER_TAXEL,
        data=frame.pressure.astype("<u2").tobytes(),  # type: ignore[arg-type]
    )


Message = TypeVar("Message", String, Image)


class Ros2Bridge(Bridge):
    """Publishes gesture (a String, told ones only), event (JSON in a String) and pressure (an Image)."""

    def __init__(
        self, settings: Ros2Settings, pad: str, labels: Sequence[str] = (), name: str | None = None
    ) -> None:
        self._settings = settings
        self._computer = name or own_name()
        self._addresses: set[str] = set()
        self._looked_s = 0.0
        self._writers: dict[str, DataWriter[Any]] = {}
        self._pad = pad
        super().__init__("ros2", [pad], math.inf)

    def open(self) -> None:
        backoff = Backoff(FIRST_RETRY_S, LONGEST_RETRY_S)
        while not self._abandoned.is_set():
            try:
                self._join()
                return
            except DDSException as error:
                self._note_away("a network for DDS", str(error).splitlines()[0])
                self._abandoned.wait(backoff.pause_s())

    def _join(self) -> None:
        """Join DDS over the current network; raises DDSException if there is none."""
        self._addresses, self._looked_s = set(own_addresses()), time.monotonic()
        participant = DomainParticipant(
            self._settings.domain, Qos(Policy.EntityName(f"touchd_{self._computer}"))
        )
        publisher = Publisher(participant)
        # ROS 2 prefixes the names of its DDS topics with rt.
        prefix = f"rt{self._settings.namespace}/{self._pad}"

        def writer(name: str, kind: type[Message]) -> DataWriter[Message]:
            return DataWriter(publisher, Topic(participant, f"{prefix}/{name}", kind), QOS)

        self._writers = {
            "gesture": writer("gesture", String),
            "event": writer("event", String),
            "pressure": writer("pressure", Image),
        }
        self._note_there("DDS")

    def pass_on(self, item: Item, until_s: float) -> bool:
        if time.monotonic() - self._looked_s > LOOK_S:
            self._looked_s = time.monotonic()
            if set(own_addresses()) != self._addresses:
                self._log.info("ros2: the network has changed; joining again")
                # DDS chooses again once all pads of this process have left; each leaves within this time.
                self._writers.clear()
                self._abandoned.wait(2 * LOOK_S)
                self.open()
        if not self._writers or time.monotonic() > until_s:
            return False
        try:
            if isinstance(item, tuple):
                self._writers["pressure"].write(image(*item))
                return True
            if isinstance(item, Prediction) and item.told:
                self._writers["gesture"].write(String(item.gesture))
            self._writers["event"].write(String(encode(item).decode()))
        # Raised, for example, when a reader accepts nothing.
        except DDSException as error:
            self._note_refused(str(error).splitlines()[0])
        return True

    def close(self) -> None:
        self._writers.clear()
