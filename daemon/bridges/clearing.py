"""Clears what former configurations left on an MQTT broker: retained states and announcements."""

import math
import time
from typing import Any

import paho.mqtt.client as mqtt

from touchd.daemon.bridges.bridge import Item
from touchd.daemon.bridges.mqtt import LOST, BrokerConnection, Client
from touchd.daemon.bridges.retained import OnBroker, Retained
from touchd.drivers.frame import Frame

# A broker publishes the last will of a killed daemon 15 s after it, at the latest.
LATE_WILL_S = 30.0


class Clearing(BrokerConnection):
    """Connects once, clears, stays for late last wills, and forgets."""

    def __init__(self, former: OnBroker, retained: Retained) -> None:
        self._former = former
        self._retained = retained
        self._to_clear: dict[int, str] = {}
        self._until_s = math.inf
        host, port = former.address
        super().__init__(former.broker, [], None, f"{host}:{port} (former topics)")

    def put(self, item: Item) -> None:
        """Ignore events."""

    def send_event(self, event: Any) -> bool:
        return True

    def send_frame(self, frame: Frame, pad: str) -> None:
        raise NotImplementedError

    def greet(self, client: Client) -> None:
        for topic in self._former.topics:
            client.subscribe(topic)
            self._clear(client, topic)

    def receive(self, client: Client, message: mqtt.MQTTMessage) -> None:
        if message.payload == LOST.encode():
            self._clear(client, message.topic)

    def published(self, number: int, is_refused: bool) -> None:
        topic = self._to_clear.pop(number, None)
        if topic is not None and not is_refused:
            self._retained.cleared(OnBroker(self._former.broker, (topic,)))
            self._log.info("mqtt: cleared %s at %s", topic, self._where)
        if not self._to_clear and self._until_s == math.inf:
            self._until_s = time.monotonic() + LATE_WILL_S

    def tend(self, client: Client) -> None:
        if time.monotonic() >= self._until_s:
            self._ending.set()
            client.disconnect()

    def _clear(self, client: Client, topic: str) -> None:
        client.allowance.sent(len(topic))
        # The broker's answer is read in this thread, so not before the number is noted.
        self._to_clear[client.publish(topic, b"", qos=1, retain=True).mid] = topic
