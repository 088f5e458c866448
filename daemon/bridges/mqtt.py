"""Publishes events, the pad's state and, if configured, its pressure on an MQTT broker."""

import math
import secrets
import ssl
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from touchd.daemon.bridges.bridge import (
    MOST_FRAMES,
    POLL_S,
    TRIES,
    Allowance,
    BridgeError,
    ConnectedBridge,
    arrival_s,
    kind_of,
)
from touchd.daemon.bridges.retained import entity_of, topics_of
from touchd.daemon.bridges.settings import MqttSettings
from touchd.daemon.path.events import UNCERTAIN, Event, SensorEvent, encode, timestamp
from touchd.drivers.errors import written_out
from touchd.drivers.frame import Frame
from touchd.drivers.whole_file import without_waiting

KEEPALIVE_S = 10
CONNECT_S = 3.0
MAX_PASSWORD_BYTES = 4096
# A broker greets, acknowledges each event in a few bytes, answers a ping every few seconds, and passes
# on what others publish to the few topics that touchd listens to.
FIRST_BYTES, ACKNOWLEDGEMENT_BYTES, OTHERS_BYTES_PER_S = 16 * 1024, 64, 64.0
# The broker does not pass on anything longer, in MQTT 5.
LONGEST_RECEIVED = 8192
# State and announcement are published again at this interval: a broker may have lost what it retained.
AGAIN_S = 120.0
# After this time, sizes that seemed too large for a broker of MQTT 3.1.1 are tried again.
DOUBT_S = 600.0
# A broker that passes nothing back must not make this grow.
MOST_ECHOES = 100
STOPPED, LOST = "stopped", "lost"
HOME_ASSISTANT_IS_THERE = b"online"
TWO_WRITERS = "two writers"
# Home Assistant's template: told answers only, with the gesture as the event's type.
TO_HOME_ASSISTANT = (
    "{% if value_json.type == 'prediction' and value_json.told %}"
    "{{ {'event_type': value_json.gesture, 'confidence': value_json.confidence, "
    "'stage': value_json.stage, 'touch': value_json.touch} | tojson }}{% endif %}"
)


class BrokerConnection(ConnectedBridge):
    """A connection to a broker: in MQTT 5, in which a broker says what it refuses and how large a message
    may be, and in 3.1.1 with brokers that lack MQTT 5.
    """

    def __init__(
        self, settings: MqttSettings, pads: Sequence[str], frames_hz: float | None, where: str
    ) -> None:
        self._settings = settings
        self._version = MQTTProtocolVersion.MQTTv5
        # The client id lets a new connection replace the lost one, whose last will the broker still holds.
        self._client_id = f"touchd-{secrets.token_hex(8)}"
        self._client: Client | None = None
        self._tls = _tls(settings.ca_file) if settings.tls else None
        self._password()
        super().__init__("mqtt", pads, frames_hz, where)

    @abstractmethod
    def greet(self, client: "Client") -> None:
        """Subscribe and publish over a new connection."""

    @abstractmethod
    def receive(self, client: "Client", message: mqtt.MQTTMessage) -> None:
        """Take a message."""

    @abstractmethod
    def tend(self, client: "Client") -> None:
        """Do what is due; called about once a second."""

    def prepare(self, client: "Client") -> None:
        """Set a client up before it connects."""

    def published(self, number: int, is_refused: bool) -> None:
        """Note that the broker has taken or refused a message."""

    def hold(self) -> str:
        client = Client(self._client_id, self._version)
        self.prepare(client)
        if self._settings.user is not None:
            client.username_pw_set(self._settings.user, self._password())
        if self._tls is not None:
            client.tls_set_context(self._tls)
        client.on_connect = self._on_connect
        client.on_publish = self._on_publish
        client.on_message = self._on_message
        properties = None
        if self._version == MQTTProtocolVersion.MQTTv5:
            properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            properties.MaximumPacketSize = LONGEST_RECEIVED
        client.connect(self._settings.host, self._settings.port, KEEPALIVE_S, properties=properties)
        self._client = client
        while client.loop(1.0) == MQTTErrorCode.MQTT_ERR_SUCCESS:
            self.tend(client)
        if not client.was_greeted:
            is_5 = self._version == MQTTProtocolVersion.MQTTv5
            self._version = MQTTProtocolVersion.MQTTv311 if is_5 else MQTTProtocolVersion.MQTTv5
        return client.why

    def hang_up(self) -> None:
        if self._client is not None:
            self._client.disconnect()

    def _password(self) -> str | None:
        """Return the password, read again for each connection; raises BridgeError."""
        file = self._settings.password_file
        return _read_password(file) if file else None

    def _on_connect(
        self, client: mqtt.Client, _data: Any, _flags: Any, code: ReasonCode, properties: Properties | None
    ) -> None:
        assert isinstance(client, Client)
        # A broker that knows only 3.1.1 answers a client of MQTT 5 with this code.
        client.was_greeted = code.getName() != "Unsupported protocol version"
        if code.is_failure:
            client.why = _words(code, properties)
            return
        client.longest_packet = getattr(properties, "MaximumPacketSize", None)
        self.greet(client)
        self.connected()

    def _on_message(self, client: mqtt.Client, _data: Any, message: mqtt.MQTTMessage) -> None:
        assert isinstance(client, Client)
        self.receive(client, message)

    def _on_publish(
        self, client: mqtt.Client, _data: Any, mid: int, code: ReasonCode, properties: Properties | None
    ) -> None:
        assert isinstance(client, Client)
        if code.is_failure:
            self._note_refused(_words(code, properties))
        self.published(mid, code.is_failure)


class MqttBridge(BrokerConnection):
    """Publishes each event with QoS 1, one at a time and in order, and the state as a retained message.

    The state is the pad's (see `SensorEvent`), "stopped" (touchd has ended) or, as the last will, "lost". The
    bridge listens to it: if another daemon's end, a late last will or a person's deletion replaces the state,
    it is published again.
    reached: called on each connection, before anything is published.
    """

    def __init__(
        self,
        settings: MqttSettings,
        pad: str,
        labels: Sequence[str] = (),
        reached: Callable[[], None] = lambda: None,
    ) -> None:
        self._labels = labels
        self._reached = reached
        self._topic = f"{settings.topic}/{pad}"
        self._state_topic, *announced = topics_of(settings, pad)
        # None if nothing is announced.
        self._announcement_topic = next(iter(announced), None)
        self._state = "down"
        # Own states that the broker has not passed back, maybe over the next connection.
        self._echoes: deque[str] = deque(maxlen=MOST_ECHOES)
        # Connections in a row that ended over an event, and what a broker of MQTT 3.1.1, which cannot say
        # it, seems to take at most, until when.
        self._ends, self._longest_taken = 0, 0
        self._seems_longest, self._seems_until_s = 0, -math.inf
        # With the topic, as each pad has a connection of its own.
        where = f"{settings.host}:{settings.port} ({self._topic})"
        super().__init__(settings, [pad], settings.pressure_hz, where)

    def prepare(self, client: "Client") -> None:
        client.will_set(self._state_topic, LOST, qos=1, retain=True)

    def greet(self, client: "Client") -> None:
        self._reached()
        topics = [self._state_topic]
        if self._announcement_topic is not None:
            topics += [self._announcement_topic, f"{self._settings.discovery}/status"]
        # Each by itself: a broker may take small packets alone.
        for topic in topics:
            client.subscribe(topic)
        self._publish_retained(client)

    def receive(self, client: "Client", message: mqtt.MQTTMessage) -> None:
        """Publish again what others have replaced, and notice another writer."""
        if message.topic == self._state_topic:
            self._see_state(client, message)
        elif message.topic == self._announcement_topic:
            if not message.payload:
                self._publish_announcement(client)
        elif message.payload == HOME_ASSISTANT_IS_THERE:
            self._publish_retained(client)

    def tend(self, client: "Client") -> None:
        if time.monotonic() >= client.again_s:
            self._publish_retained(client)

    def send_event(self, event: Event) -> bool:
        if isinstance(event, SensorEvent):
            self._state = event.state
        client = self._client
        if client is None:
            return False
        if isinstance(event, SensorEvent):
            self._publish_state(client)
        topic, payload = f"{self._topic}/event", encode(event)
        if not self._fits(client, topic, payload, kind_of(event)):
            return True
        is_taken = self._await(client, client.publish(topic, payload, qos=1))
        self._learn(client, _size(topic, payload, qos=1), is_taken)
        return is_taken

    def send_frame(self, frame: Frame, pad: str) -> None:
        client = self._client
        if client is None:
            return
        # paho's queue has no limit, so limit the frames in it: the broker may read nothing.
        while client.frames and client.frames[0].is_published():
            client.frames.popleft()
        if len(client.frames) >= MOST_FRAMES:
            self._items.dropped += 1
            return
        payload = _pressure(frame)
        if not self._fits(client, f"{self._topic}/pressure", payload, "pressure", qos=0):
            return
        info = client.publish(f"{self._topic}/pressure", payload)
        if info.rc == MQTTErrorCode.MQTT_ERR_SUCCESS:
            client.frames.append(info)

    def close(self) -> None:
        if self._peer_is_there.is_set() and (client := self._client):
            self._state = STOPPED
            self._await(client, self._publish_state(client))
        super().close()

    def _see_state(self, client: "Client", message: mqtt.MQTTMessage) -> None:
        state = message.payload.decode(errors="replace")
        if state in self._echoes:
            self._echoes.remove(state)
        # As it was before this connection.
        elif message.retain:
            return
        elif state in ("", STOPPED, LOST):
            self._faults.end(TWO_WRITERS)
            self._publish_state(client)
        elif self._faults.begin(
            TWO_WRITERS, f"another touchd publishes to {self._topic}, too; give each its own mqtt.topic"
        ):
            # Once, so that the other one notices, too.
            self._publish_state(client)

    def _publish_retained(self, client: "Client") -> None:
        client.again_s = time.monotonic() + AGAIN_S
        self._publish_announcement(client)
        self._publish_state(client)

    def _publish_announcement(self, client: "Client") -> None:
        topic = self._announcement_topic
        if topic is None or not client.takes_announcement:
            return
        payload = announcement(self._topic, self._labels)
        client.takes_announcement = self._fits(client, topic, payload, "announcement to Home Assistant")
        if client.takes_announcement:
            client.allowance.sent(len(topic) + len(payload))
            info = client.publish(topic, payload, qos=1, retain=True)
            if info.rc == MQTTErrorCode.MQTT_ERR_SUCCESS:
                client.announced = info, _size(topic, payload, qos=1)

    def _publish_state(self, client: "Client") -> mqtt.MQTTMessageInfo:
        client.allowance.sent(len(self._state_topic) + len(self._state))
        self._echoes.append(self._state)
        return client.publish(self._state_topic, self._state, qos=1, retain=True)

    def _fits(self, client: "Client", topic: str, payload: bytes, what: str, qos: int = 1) -> bool:
        """Whether the broker takes a message of this size; one that is too large is counted as refused."""
        size, longest = _size(topic, payload, qos), client.longest_packet
        how = "takes"
        if longest is None and time.monotonic() < self._seems_until_s:
            longest, how = self._seems_longest, "ended connections over larger ones, so perhaps takes"
        if longest is None or size <= longest:
            return True
        self._note_refused(f"{what}: {size} bytes, and the broker {how} {longest} at most")
        return False

    def _learn(self, client: "Client", size: int, is_taken: bool) -> None:
        """Find out from connections that end what a broker takes that cannot say it."""
        self._ends = 0 if is_taken else self._ends + 1
        if is_taken:
            self._longest_taken = max(self._longest_taken, size)
        if self._ends < TRIES or self._version == MQTTProtocolVersion.MQTTv5:
            return
        # The announcement was sent first, and is longer.
        if client.announced is not None and not client.announced[0].is_published():
            size = client.announced[1]
        self._ends = 0
        # Not over the size if the broker has taken as much before.
        if size > self._longest_taken:
            # A good step down, since each further one costs more connections.
            self._seems_longest = max(self._longest_taken, size * 3 // 4)
            self._seems_until_s = time.monotonic() + DOUBT_S

    def _await(self, client: "Client", info: mqtt.MQTTMessageInfo) -> bool:
        """Wait until the broker has acknowledged or refused a message; False if the connection ends first."""
        client.allowance.sent()
        while info.rc == MQTTErrorCode.MQTT_ERR_SUCCESS and not self._abandoned.is_set():
            info.wait_for_publish(POLL_S)
            if info.is_published():
                return True
            if client.has_ended:
                return False
        return False


class Client(mqtt.Client):
    """A paho client for one connection.

    why: reason for its end. frames: not yet written by paho. again_s: when state and announcement are due.
    longest_packet: that the broker takes, None: any. announced: the announcement and its size.
    """

    def __init__(self, name: str, version: MQTTProtocolVersion) -> None:
        super().__init__(CallbackAPIVersion.VERSION2, name, protocol=version, reconnect_on_failure=False)
        self.connect_timeout = CONNECT_S
        self.allowance = Allowance(FIRST_BYTES, ACKNOWLEDGEMENT_BYTES, OTHERS_BYTES_PER_S)
        self.again_s = math.inf
        self.longest_packet: int | None = None
        self.takes_announcement = True
        self.announced: tuple[mqtt.MQTTMessageInfo, int] | None = None
        self.frames: deque[mqtt.MQTTMessageInfo] = deque()
        self.was_greeted = self.has_ended = False
        self.why = ""
        self.on_disconnect = self._on_end
        # With this callback, paho writes only in `loop` and not also in the thread that publishes.
        self.on_socket_register_write = lambda *_: None

    def _sock_recv(self, bufsize: int) -> bytes:
        # paho would buffer a message of 256 MiB, and hold every message of QoS 2 until it is released.
        data: bytes = super()._sock_recv(bufsize)
        if not self.allowance.take(len(data)):
            raise ConnectionAbortedError
        return data

    def _on_end(
        self, _client: Any, _data: Any, flags: Any, code: ReasonCode, properties: Properties | None
    ) -> None:
        self.has_ended = True
        if self.allowance.is_spent:
            self.why = "it sends more than touchd asks for"
        elif flags.is_disconnect_packet_from_server or code.getName() == "Keep alive timeout":
            self.why = _words(code, properties)
        elif not self.why and self.was_greeted:
            # paho reports only "Unspecified error" here.
            self.why = "the connection was closed"
        elif not self.why:
            self.why = "the connection was closed before a greeting: is it a broker, and does it want TLS?"


def _size(topic: str, payload: bytes, qos: int) -> int:
    # The topic with its length, the packet's number and properties, then the fixed header.
    rest = 2 + len(topic.encode()) + (2 if qos else 0) + 1 + len(payload)
    return 1 + -(-rest.bit_length() // 7) + rest


def _words(code: ReasonCode, properties: Properties | None) -> str:
    """Return a reason code with the broker's own words, if it sent any."""
    said = getattr(properties, "ReasonString", "")
    return f"{code}: {said}" if said else str(code)


def announcement(topic: str, labels: Sequence[str]) -> bytes:
    """Return what announces a pad to Home Assistant as an event entity."""
    name = entity_of(topic)
    payload = {
        "name": None,
        "unique_id": name,
        "state_topic": f"{topic}/event",
        "event_types": [*labels, UNCERTAIN],
        "value_template": TO_HOME_ASSISTANT,
        "availability_topic": f"{topic}/state",
        "availability_template": "{{ 'online' if value in ('up', 'degraded') else 'offline' }}",
        "device": {"identifiers": [name], "name": topic, "manufacturer": "touchd"},
        "icon": "mdi:hand-heart",
    }
    return msgspec.json.encode(payload)


def _pressure(frame: Frame) -> bytes:
    fields = {"time": timestamp(arrival_s(frame)), "sensor_ms": frame.sensor_ms}
    return msgspec.json.encode(fields | {"pressure": frame.pressure.tolist()})


def _read_password(file: str) -> str:
    try:
        with open(written_out(file), encoding="utf-8-sig", opener=without_waiting) as opened:
            password = opened.read(MAX_PASSWORD_BYTES).strip()
    except (OSError, UnicodeDecodeError) as error:
        raise BridgeError(
            f"mqtt.password_file: {file} cannot be read ({error}); check path and owner"
        ) from error
    if not password:
        raise BridgeError(f"mqtt.password_file: {file} is empty; put the password there")
    return password


def _tls(ca_file: str | None) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=str(written_out(ca_file)) if ca_file else None)
    except (OSError, ssl.SSLError) as error:
        raise BridgeError(f"mqtt.ca_file: {ca_file} cannot be used ({error}); give a file of PEM") from error
