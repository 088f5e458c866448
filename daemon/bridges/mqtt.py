"""MQTT: events, the pad's state and, where wanted, its pressure on a broker."""

import secrets
import ssl
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import msgspec
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from touchd.daemon.bridges.bridge import POLL_S, Bridge, BridgeError, arrival_s
from touchd.daemon.bridges.settings import MqttSettings
from touchd.daemon.events import UNCERTAIN, Event, SensorEvent, encode, timestamp
from touchd.drivers.frame import Frame
from touchd.drivers.paths import written_out

KEEPALIVE_S = 10
CONNECT_S = 3.0
RECONNECT_FIRST_S, RECONNECT_CAP_S = 0.1, 1.0
MAX_PASSWORD_BYTES = 4096
# Home Assistant's template: told answers only, with the gesture as the event's type.
TO_HOME_ASSISTANT = (
    "{% if value_json.type == 'prediction' and value_json.told %}"
    "{{ {'event_type': value_json.gesture, 'confidence': value_json.confidence, "
    "'stage': value_json.stage, 'touch': value_json.touch} | tojson }}{% endif %}"
)


class MqttBridge(Bridge):
    """Publishes each event with QoS 1, one at a time and in order, and keeps the state retained.

    The state is the pad's (see `SensorEvent`), stopped (touchd has ended) or, as the last will, lost.
    paho's own thread keeps the connection and reconnects.
    """

    def __init__(self, settings: MqttSettings, pad: str, labels: Sequence[str] = ()) -> None:
        self._settings = settings
        self._labels = labels
        self._topic = f"{settings.topic}/{pad}"
        self._where = f"{settings.host}:{settings.port}"
        self._state = "down"
        self._refusal = ""
        self._greeting: mqtt.MQTTMessageInfo | None = None
        self._acknowledged: set[int] = set()
        self._acknowledging = threading.Condition()
        # By its name a broker knows whose lost connection, and will, it still holds.
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, f"touchd-{secrets.token_hex(8)}")
        self._client.connect_timeout = CONNECT_S
        self._client.reconnect_delay_set(RECONNECT_FIRST_S, RECONNECT_CAP_S)  # type: ignore[arg-type]
        self._client.will_set(f"{self._topic}/state", "lost", qos=1, retain=True)
        self._log_in()
        if settings.tls:
            self._client.tls_set_context(_tls(settings.ca_file))
        self._client.on_pre_connect = self._on_pre_connect
        self._client.on_connect = self._on_connect
        self._client.on_connect_fail = lambda *_: self._tell_away(self._where, "cannot be reached")
        self._client.on_disconnect = self._on_disconnect
        self._client.on_publish = self._on_publish
        super().__init__("mqtt", pad, settings.pressure_hz)

    def open(self) -> None:
        self._client.connect_async(self._settings.host, self._settings.port, KEEPALIVE_S)
        self._client.loop_start()

    def write(self, item: Event | Frame) -> None:
        """Publish an event and wait until the broker has it, or publish a frame."""
        if isinstance(item, Frame):
            self._client.publish(f"{self._topic}/pressure", _pressure(item))
            with self._acknowledging:
                # paho reports frames too, and uses its numbers again.
                self._acknowledged.clear()
            return
        if isinstance(item, SensorEvent):
            self._state = item.state
        if not self._await_peer():
            return
        if isinstance(item, SensorEvent):
            self._publish_state()
        self._await(self._client.publish(f"{self._topic}/event", encode(item), qos=1))

    def close(self) -> None:
        if self._peer_is_there.is_set():
            self._state = "stopped"
            self._await(self._publish_state())
        self._client.disconnect()
        self._client.loop_stop()

    def _log_in(self) -> None:
        """Take user and password from the settings; raises BridgeError."""
        if self._settings.user is not None:
            file = self._settings.password_file
            self._client.username_pw_set(self._settings.user, _read_password(file) if file else None)

    def _on_pre_connect(self, *_: Any) -> None:
        # The password may have been corrected since.
        with suppress(BridgeError):
            self._log_in()

    def _on_connect(self, client: mqtt.Client, _data: Any, _flags: Any, code: Any, _properties: Any) -> None:
        if code.is_failure:
            refusal, self._refusal = self._refusal, str(code)
            self._tell_away(self._where, str(code), is_news=refusal != str(code))
            return
        self._refusal = ""
        # What the broker has not acknowledged, paho sends again.
        if self._greeting is None or self._greeting.is_published():
            if self._settings.discovery is not None:
                topic, payload = discovery(self._settings.discovery, self._topic, self._labels)
                client.publish(topic, payload, qos=1, retain=True)
            self._greeting = self._publish_state()
        self._tell_there(self._where)

    def _on_disconnect(self, *ends: Any) -> None:
        self._tell_away(self._where, str(ends[3]))
        until_s = time.monotonic() + self._backoff.pause_s()
        while time.monotonic() < until_s and not self._draining:
            time.sleep(POLL_S)

    def _publish_state(self) -> mqtt.MQTTMessageInfo:
        return self._client.publish(f"{self._topic}/state", self._state, qos=1, retain=True)

    def _on_publish(self, _client: mqtt.Client, _data: Any, mid: int, *_: Any) -> None:
        with self._acknowledging:
            self._acknowledged.add(mid)
            self._acknowledging.notify()

    def _await(self, info: mqtt.MQTTMessageInfo) -> None:
        """Wait until the broker has acknowledged a message; over a lost connection paho sends it again."""
        with self._acknowledging:
            while info.mid not in self._acknowledged and not self._abandoned.is_set():
                self._acknowledging.wait(POLL_S)
            self._acknowledged.clear()


def discovery(prefix: str, topic: str, labels: Sequence[str]) -> tuple[str, bytes]:
    """Return topic and payload that announce a pad to Home Assistant as an event entity."""
    name = topic.replace("/", "_")
    payload = {
        "name": None,
        "unique_id": name,
        "state_topic": f"{topic}/event",
        "event_types": [*labels, UNCERTAIN],
        "value_template": TO_HOME_ASSISTANT,
        "availability_topic": f"{topic}/state",
        "availability_template": "{{ 'online' if value in ('up', 'disturbed') else 'offline' }}",
        "device": {"identifiers": [name], "name": topic, "manufacturer": "touchd"},
        "icon": "mdi:hand-heart",
    }
    return f"{prefix}/event/{name}/config", msgspec.json.encode(payload)


def _pressure(frame: Frame) -> bytes:
    fields = {"time": timestamp(arrival_s(frame)), "sensor_ms": frame.sensor_ms}
    return msgspec.json.encode(fields | {"pressure": frame.pressure.tolist()})


def _read_password(file: str) -> str:
    try:
        with written_out(file).open(encoding="utf-8") as opened:
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
