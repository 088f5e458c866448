"""Publishes events, the pad's state and, if configured, its pressure on an MQTT broker."""

import secrets
import socket
import ssl
import threading
from collections.abc import Sequence
from typing import Any

import msgspec
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from touchd.daemon.bridges.bridge import MOST_FRAMES, POLL_S, Bridge, BridgeError, PeerLimit, arrival_s
from touchd.daemon.bridges.settings import MqttSettings
from touchd.daemon.path.events import UNCERTAIN, Event, SensorEvent, TouchBegan, TouchEnded, encode, timestamp
from touchd.drivers import hosts
from touchd.drivers.errors import expand_home
from touchd.drivers.frame import Frame
from touchd.drivers.whole_file import secret_in

KEEPALIVE_S = 10
CONNECT_S = 3.0
STOPPED, LOST = "stopped", "lost"
HOME_ASSISTANT_IS_THERE = b"online"
# The answer of a broker that supports only MQTT 3.1.1.
NO_MQTT_5 = "Unsupported protocol version"
# Home Assistant's template: told answers only, with the gesture as the event's type.
TO_HOME_ASSISTANT = (
    "{% if value_json.type == 'prediction' and value_json.told %}"
    "{{ {'event_type': value_json.gesture, 'confidence': value_json.confidence, "
    "'stage': value_json.stage, 'touch': value_json.touch} | tojson }}{% endif %}"
)


class MqttBridge(Bridge):
    """Publishes each event with QoS 1, one at a time and in order, and the state as a retained message.

    The state is the pad's (see `SensorEvent`), "stopped" (touchd has ended) or, as the last will, "lost".
    With `discovery` it announces the pad to Home Assistant and publishes whether it is touched.
    It uses MQTT 5, in which a broker gives the reason of a refusal, or 3.1.1 with brokers that lack it.
    name: of the robot. labels: the gestures that an answer can have.
    """

    def __init__(self, settings: MqttSettings, name: str, pad: str, labels: Sequence[str] = ()) -> None:
        self._settings = settings
        self._labels = labels
        self._topic = f"{name}/{pad}"
        # Each pad has a connection of its own.
        where = f"{settings.host}:{settings.port} ({self._topic})"
        super().__init__("mqtt", [pad], settings.pressure_hz, where)
        self._state, self._is_touched = "down", False
        # Held while retained messages are published, so that the newest is published last.
        self._retaining = threading.Lock()
        # One id for all connections: a new one replaces a lost one, whose last will the broker still holds.
        # Its random end keeps cloned computers from ending each other's connections.
        own = f"touchd_{socket.gethostname()}_{self._topic}_{secrets.token_hex(4)}"
        self._client_id = own.replace("/", "_")
        # The first is tried next.
        self._versions = [MQTTProtocolVersion.MQTTv5, MQTTProtocolVersion.MQTTv311]
        # Reports wrong files now; each connection reads them again.
        self._client = self._new_client()

    def hold(self) -> str:
        client = self._new_client()
        client.connect(self._settings.host, self._settings.port, KEEPALIVE_S)
        self._client = client
        while client.loop() == MQTTErrorCode.MQTT_ERR_SUCCESS:
            pass
        if not client.is_greeted:
            self._versions.reverse()
        return client.why

    def hang_up(self) -> None:
        self._client.disconnect()

    def _new_client(self) -> "_Client":
        """Return a client with the last will, the password and what TLS needs; raises BridgeError."""
        client = _Client(self._client_id, self._versions[0], self.limit, self._ending)
        client.on_connect = self._on_connect
        client.on_publish = self._on_publish
        client.on_message = self._on_message
        client.will_set(f"{self._topic}/state", LOST, qos=1, retain=True)
        settings = self._settings
        if settings.user is not None:
            file = settings.password_file
            password = secret_in(file, "mqtt.password_file", BridgeError) if file else None
            client.username_pw_set(settings.user, password)
        if settings.tls:
            file = settings.ca_file
            try:
                tls = ssl.create_default_context(cafile=str(expand_home(file)) if file else None)
            except OSError as error:
                why = f"mqtt.ca_file: {file} cannot be used ({error}); give a file of PEM"
                raise BridgeError(why) from error
            client.tls_set_context(tls)
        return client

    def note(self, event: Event) -> None:
        """Publish retained values when they change, even if the event itself is stale."""
        with self._retaining:
            before = self._state, self._is_touched
            match event:
                case SensorEvent():
                    self._state = event.state
                    self._is_touched &= event.state != "down"
                case TouchBegan():
                    self._is_touched = True
                case TouchEnded():
                    self._is_touched = False
            # A new connection publishes them in any case.
            if before != (self._state, self._is_touched) and self._peer_is_there.is_set():
                self._publish_values(self._client)

    def send_event(self, event: Event) -> bool:
        client = self._client
        return self._await(client, client.send(f"{self._topic}/event", encode(event)))

    def send_frame(self, frame: Frame, pad: str) -> None:
        client = self._client
        # paho's own queue has no limit.
        if len(client._out_packet) >= MOST_FRAMES:
            self._items.dropped += 1
            return
        when = {"time": timestamp(arrival_s(frame)), "sensor_ms": frame.sensor_ms}
        content = msgspec.json.encode(when | {"pressure": frame.pressure.tolist()})
        client.publish(f"{self._topic}/pressure", content)

    def close(self) -> None:
        if self._peer_is_there.is_set():
            client, self._state = self._client, STOPPED
            self._await(client, self._publish_values(client))
        super().close()

    def _on_connect(
        self, client: Any, _data: Any, _flags: Any, code: ReasonCode, properties: Properties | None
    ) -> None:
        client.is_greeted = code.getName() != NO_MQTT_5
        # paho calls this "Unspecified error".
        client.why = _words(code, properties) if code.is_failure else "the connection was closed"
        if code.is_failure:
            return
        if self._settings.discovery is not None:
            client.subscribe(f"{self._settings.discovery}/status")
        with self._retaining:
            self._announce(client)
            self.connected()

    def _on_publish(
        self, client: Any, _data: Any, mid: int, code: ReasonCode, properties: Properties | None
    ) -> None:
        topic = client.topics.pop(mid, "a message")
        if code.is_failure:
            self.note_refused(f"{topic}: {_words(code, properties)}")

    def _on_message(self, client: Any, _data: Any, message: mqtt.MQTTMessage) -> None:
        if message.payload == HOME_ASSISTANT_IS_THERE:
            with self._retaining:
                self._announce(client)

    def _announce(self, client: "_Client") -> None:
        """Publish all retained messages."""
        if self._settings.discovery is not None:
            for topic, payload in announcements(self._settings.discovery, self._topic, self._labels).items():
                client.send(topic, payload, retain=True)
        self._publish_values(client)

    def _publish_values(self, client: "_Client") -> mqtt.MQTTMessageInfo:
        if self._settings.discovery is not None:
            client.send(f"{self._topic}/touched", b"ON" if self._is_touched else b"OFF", retain=True)
        return client.send(f"{self._topic}/state", self._state.encode(), retain=True)

    def _await(self, client: "_Client", info: mqtt.MQTTMessageInfo) -> bool:
        """Wait until the broker has acknowledged or refused a message; False if the connection ends first."""
        while info.rc == MQTTErrorCode.MQTT_ERR_SUCCESS and not self._abandoned.is_set():
            info.wait_for_publish(POLL_S)
            if info.is_published():
                return True
            if client is not self._client or not self._peer_is_there.is_set():
                break
        return False


class _Client(mqtt.Client):
    """A paho client for one connection.

    is_greeted: whether the broker has answered in this version of MQTT. why: why the connection ended.
    topics: of messages that the broker has not acknowledged, by number.
    """

    def __init__(
        self, name: str, version: MQTTProtocolVersion, limit: PeerLimit, stopping: threading.Event
    ) -> None:
        # The bridge reconnects, with a new client without leftovers of the lost connection.
        super().__init__(CallbackAPIVersion.VERSION2, name, protocol=version, reconnect_on_failure=False)
        self.is_greeted = False
        self.why = "the connection was closed before a greeting: is it a broker, and does it want TLS?"
        self.topics: dict[int, str] = {}
        self._limit, self._stopping = limit, stopping
        self.on_disconnect = self._on_end
        # With this callback, paho writes only in its loop and not also in the thread that publishes.
        self.on_socket_register_write = lambda *_: None

    def send(self, topic: str, payload: bytes, retain: bool = False) -> mqtt.MQTTMessageInfo:
        """Publish with QoS 1."""
        info = self.publish(topic, payload, qos=1, retain=retain)
        self.topics[info.mid] = topic
        return info

    def _create_socket_connection(self) -> socket.socket:
        return hosts.connect(self.host, self.port, CONNECT_S, self._stopping)

    def _sock_recv(self, bufsize: int) -> bytes:
        # paho would buffer a message of 256 MiB, and hold every message of QoS 2 until it is released.
        data: bytes = super()._sock_recv(bufsize)
        if not self._limit.take(len(data)):
            self.why = "it sends more than touchd asks for"
            raise ConnectionAbortedError
        return data

    def _on_end(
        self, _client: Any, _data: Any, flags: Any, code: ReasonCode, properties: Properties | None
    ) -> None:
        if flags.is_disconnect_packet_from_server or code.getName() == "Keep alive timeout":
            self.why = _words(code, properties)


def _words(code: ReasonCode, properties: Properties | None) -> str:
    """Return a reason code with the broker's own words, if it sent any."""
    reason = getattr(properties, "ReasonString", "")
    return f"{code}: {reason}" if reason else str(code)


def announcements(discovery: str, topic: str, labels: Sequence[str]) -> dict[str, bytes]:
    """Return the messages that announce a pad's entities to Home Assistant, by topic."""
    name = topic.replace("/", "_")
    common = {
        "availability_topic": f"{topic}/state",
        "availability_template": "{{ 'online' if value in ('up', 'degraded') else 'offline' }}",
        "device": {"identifiers": [name], "name": topic, "manufacturer": "touchd"},
        "icon": "mdi:hand-heart",
    }
    gestures = {
        "name": None,
        "unique_id": name,
        "state_topic": f"{topic}/event",
        "event_types": [*labels, UNCERTAIN],
        "value_template": TO_HOME_ASSISTANT,
    }
    touched = {"name": "Touched", "unique_id": f"{name}_touched", "state_topic": f"{topic}/touched"}
    return {
        f"{discovery}/event/{name}/config": msgspec.json.encode(gestures | common),
        f"{discovery}/binary_sensor/{name}_touched/config": msgspec.json.encode(touched | common),
    }
