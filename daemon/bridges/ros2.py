"""ROS 2 without a ROS installation: the messages that its nodes publish, over DDS."""

import math
from collections.abc import Sequence
from typing import TypeVar

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from daemon.bridges.bridge import Bridge
from daemon.bridges.ros2_types import Image, String, image
from daemon.bridges.settings import Ros2Settings
from daemon.events import Event, Prediction, encode
from drivers.frame import Frame

# The defaults of rclpy and rclcpp. A reliable writer suits reliable and best-effort readers.
QOS = Qos(
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.Durability.Volatile,
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)

Message = TypeVar("Message", String, Image)


class Ros2Bridge(Bridge):
    """Publishes gesture (told ones, a String), event (JSON in a String) and pressure (an Image)."""

    def __init__(self, settings: Ros2Settings, pad: str, labels: Sequence[str] = ()) -> None:
        self._settings = settings
        super().__init__("ros2", pad, math.inf)

    def open(self) -> None:
        participant = DomainParticipant(self._settings.domain)
        publisher = Publisher(participant)
        # ROS 2 has its topics under rt.
        prefix = f"rt{self._settings.namespace}/{self.pad}"

        def writer(name: str, kind: type[Message]) -> DataWriter[Message]:
            return DataWriter(publisher, Topic(participant, f"{prefix}/{name}", kind), QOS)

        self._gesture = writer("gesture", String)
        self._event = writer("event", String)
        self._pressure = writer("pressure", Image)
        self._peer_is_there.set()

    def write(self, item: Event | Frame) -> None:
        if isinstance(item, Frame):
            self._pressure.write(image(item, self.pad))
            return
        if isinstance(item, Prediction) and item.told:
            self._gesture.write(String(item.gesture))
        self._event.write(String(encode(item).decode()))

    def close(self) -> None:
        del self._gesture, self._event, self._pressure
