"""MQTT on a real mosquitto: topics, state and last will, pressure, login, TLS, Home Assistant."""

import json
import os
import re
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest
from rigs import attackers
from rigs.made_events import PREDICTION, TIME, touch
from rigs.peers import PAD, broker, frame, needs_mosquitto, subscribed
from rigs.running_daemon import Daemon
from rigs.scripted_model import Scripted
from rigs.sockets import free_port
from rigs.wait import AT_ONCE_S, WITHIN_S, wait_for

from touchd.daemon.app.config import Settings
from touchd.daemon.app.parts import make_bridges
from touchd.daemon.bridges.bridge import Bridge, BridgeError
from touchd.daemon.bridges.settings import MqttSettings
from touchd.daemon.path.events import SensorEvent, TouchEnded, encode
from touchd.daemon.sinks.touches import decode
from touchd.drivers.frame import NO_TOUCH

publishing = pytest.importorskip("paho.mqtt.publish")
pytestmark = needs_mosquitto

UP = SensorEvent(state="up", time=TIME)
DOWN = SensorEvent(state="down", time=TIME, reason="unplugged")
ENDED = TouchEnded(touch=1, gesture="pat", frames=60, reason="released", time=TIME)


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    """A broker without login."""
    port = free_port()
    with broker(tmp_path, port):
        yield port


Open = Callable[..., Bridge]


def made(port: int, **settings: Any) -> list[Bridge]:
    name = settings.pop("name", "touchd")
    mqtt = MqttSettings(**({"host": "127.0.0.1", "port": port} | settings))
    return list(make_bridges(Settings(mqtt=mqtt, name=name), {"pad": Scripted()}))


@pytest.fixture
def opened(port: int) -> Iterator[Open]:
    """Opens bridges with given settings; closes them after the test."""
    with ExitStack() as closing:

        def open_bridge(at: int = port, **settings: Any) -> Bridge:
            (bridge,) = made(at, **settings)
            bridge.retry_s = 0.1
            bridge.start()
            closing.callback(bridge.stop, 2.0)
            return bridge

        yield open_bridge


@pytest.fixture
def messages(port: int) -> Iterator[list[Any]]:
    """All that the broker gets under touchd."""
    with subscribed(port, "touchd/#") as messages:
        yield messages


def payloads(messages: list[Any], topic: str = "touchd/pad/event") -> list[str]:
    return [message.payload.decode() for message in messages if message.topic == topic]


def put(bridge: Bridge, number: int, messages: list[Any]) -> None:
    """Put touch `number`, and wait until this many events were published."""
    bridge.put(touch(number))
    wait_for(lambda: len(payloads(messages)) == number)


def publish(port: int, topic: str, payload: str) -> None:
    """Publish as another program would."""
    publishing.single(topic, payload, 1, hostname="127.0.0.1", port=port)


def all_retained(port: int) -> dict[str, str]:
    """Return the broker's retained messages by topic."""
    with subscribed(port, "#") as messages:
        publish(port, "end", "")
        wait_for(lambda: any(message.topic == "end" for message in messages))
    return {message.topic: message.payload.decode() for message in messages if message.retain}


def retained(port: int, topic: str = "touchd/pad/state") -> str | None:
    return all_retained(port).get(topic)


def test_the_pads_own_events_come_with_qos_1(messages: list[Any], opened: Open) -> None:
    bridge = opened()
    events = [UP, touch(1), PREDICTION]
    for event in [msgspec.structs.replace(PREDICTION, pad="another"), *events]:
        bridge.put(event)
    wait_for(lambda: len(payloads(messages)) == 3)
    assert [decode(text) for text in payloads(messages)] == events
    assert {message.qos for message in messages if message.topic.endswith("event")} == {1}


def test_the_state_is_retained_and_follows_the_pad(port: int, opened: Open) -> None:
    bridge = opened()
    bridge.put(UP)
    bridge.put(DOWN)
    bridge.put(UP)
    wait_for(lambda: retained(port) == "up")
    bridge.stop(WITHIN_S)
    assert retained(port) == "stopped"
    wait_for(lambda: "touchd-mqtt-link" not in {thread.name for thread in threading.enumerate()}, AT_ONCE_S)


def test_a_daemon_that_is_killed_leaves_its_last_will(port: int, tmp_path: Path) -> None:
    with Daemon(tmp_path, mqtt=MqttSettings(host="127.0.0.1", port=port)) as daemon:
        wait_for(lambda: retained(port) == "up")
        daemon.process.kill()
        wait_for(lambda: retained(port) == "lost")


def test_a_reconnect_replaces_the_last_will_of_the_old_connection(port: int, opened: Open) -> None:
    bridge: Any = opened()
    bridge.put(UP)
    wait_for(lambda: retained(port) == "up")
    lost = bridge._client
    # The router between them forgets the connection: touchd notices, the broker does not.
    with lost.socket().dup() as brokers_end:
        lost._sock_close()
        wait_for(lambda: bridge._client is not lost and bridge._peer_is_there.is_set())
        brokers_end.settimeout(WITHIN_S)
        while brokers_end.recv(4096):
            pass
    wait_for(lambda: retained(port) == "up")


def test_pressure_comes_at_the_stated_rate_and_only_when_asked(messages: list[Any], opened: Open) -> None:
    bridge = opened(pressure_hz=18.0)
    put(bridge, 1, messages)
    start_s = time.monotonic()
    for number in range(54):
        bridge.put_frame(frame(number, start_s + number / 54.0), PAD)
    wait_for(lambda: len(payloads(messages, "touchd/pad/pressure")) >= 18)
    put(bridge, 2, messages)
    shown = [json.loads(text) for text in payloads(messages, "touchd/pad/pressure")]
    assert len(shown) == 18
    assert shown[0]["pressure"] == frame(0).pressure.tolist()
    assert shown[1]["sensor_ms"] == 3 * 19
    bridge = opened()
    put(bridge, 3, messages)
    bridge.put_frame(frame(99), PAD)
    put(bridge, 4, messages)
    assert len(payloads(messages, "touchd/pad/pressure")) == 18


def only_robot(folder: Path) -> str:
    """Return a broker's settings that admit only the user robot with the password s3cret."""
    users = str(folder / "users")
    subprocess.run(["mosquitto_passwd", "-b", "-c", users, "robot", "s3cret"], check=True, timeout=10)
    return f"allow_anonymous false\npassword_file {users}\nuser root\n"


def test_it_logs_in_over_tls_with_a_password_file(tmp_path: Path, opened: Open) -> None:
    trustme = pytest.importorskip("trustme")
    authority = trustme.CA()
    certificate = authority.issue_cert("localhost")
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    certificate.private_key_pem.write_to_path(tmp_path / "key.pem")
    certificate.cert_chain_pems[0].write_to_path(tmp_path / "cert.pem")
    # As an editor on Windows may save it.
    (tmp_path / "password").write_bytes(b"\xef\xbb\xbfs3cret\r\n")
    lines = f"cafile {tmp_path}/ca.pem\ncertfile {tmp_path}/cert.pem\nkeyfile {tmp_path}/key.pem\n"
    port = free_port()
    ca_file = str(tmp_path / "ca.pem")
    with (
        broker(tmp_path, port, lines + only_robot(tmp_path)),
        subscribed(port, "touchd/#", user="robot", password="s3cret", ca_file=ca_file) as messages,
    ):
        login = {"user": "robot", "password_file": str(tmp_path / "password")}
        put(opened(port, host="localhost", tls=True, ca_file=ca_file, **login), 1, messages)


def test_a_refusal_is_logged_once_and_a_corrected_password_used(
    tmp_path: Path, opened: Open, caplog: pytest.LogCaptureFixture
) -> None:
    password = tmp_path / "password"
    password.write_text("guess")
    port = free_port()
    with caplog.at_level("INFO"):
        opened(port, user="robot", password_file=str(password))
        wait_for(lambda: "cannot be reached" in caplog.text)
        with broker(tmp_path, port, only_robot(tmp_path)):
            wait_for(lambda: "Not authorized" in caplog.text)
            password.write_text("s3cret")
            wait_for(lambda: "connected to" in caplog.text)
            said = list(caplog.messages)
    parts = ("cannot be reached", "Not authorized", "connected to")
    for line, part in zip(said, parts, strict=True):
        assert part in line


def test_a_password_file_without_a_password_is_refused_at_once(port: int, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for file, why in (("nowhere", "cannot be read"), ("pipe", "is empty")):
        with pytest.raises(BridgeError, match=rf"mqtt\.password_file {tmp_path}/{file} {why}"):
            made(port, user="robot", password_file=str(tmp_path / file))


def test_home_assistant_shows_gestures_and_whether_the_pad_is_touched(port: int, opened: Open) -> None:
    jinja2 = pytest.importorskip("jinja2")
    bridge = opened(name="lab/nao1", discovery="homeassistant")
    bridge.put(UP)
    wait_for(lambda: all_retained(port).get("lab/nao1/pad/state") == "up")
    told = all_retained(port)
    gestures = json.loads(told["homeassistant/event/lab_nao1_pad/config"])
    touched = json.loads(told["homeassistant/binary_sensor/lab_nao1_pad_touched/config"])
    assert gestures["state_topic"] == "lab/nao1/pad/event"
    assert gestures["device"] == touched["device"]

    def rendered(template: str, **values: Any) -> str:
        return str(jinja2.Environment().from_string(template).render(**values))

    event = json.loads(rendered(gestures["value_template"], value_json=json.loads(encode(PREDICTION))))
    assert event["event_type"] in gestures["event_types"]
    assert NO_TOUCH not in gestures["event_types"]
    assert event == {"event_type": "stroke", "confidence": 0.81, "stage": "early", "touch": 7}
    assert rendered(gestures["value_template"], value_json=json.loads(encode(touch(1)))) == ""
    states = ("up", "degraded", "down", "stopped", "lost")
    for entity in (gestures, touched):
        available = [rendered(entity["availability_template"], value=state) for state in states]
        assert available == ["online"] * 2 + ["offline"] * 3
    for event, state in ((touch(1), "ON"), (ENDED, "OFF"), (touch(2), "ON"), (DOWN, "OFF")):
        assert told[touched["state_topic"]] != state
        bridge.put(event)
        wait_for(lambda state=state: all_retained(port)[touched["state_topic"]] == state)
        told = all_retained(port)
    with subscribed(port, "homeassistant/+/+/config") as messages:
        wait_for(lambda: len(messages) == 2)
        # Home Assistant has started.
        publish(port, "homeassistant/status", "online")
        wait_for(lambda: len(messages) == 4)


def test_a_state_that_changed_without_the_broker_is_retained(
    tmp_path: Path, opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The event itself is stale by then.
    monkeypatch.setattr("touchd.daemon.bridges.bridge.STALE_S", 0.1)
    port = free_port()
    with broker(tmp_path, port):
        bridge = opened(port)
        bridge.put(UP)
        wait_for(lambda: retained(port) == "up")
    bridge.put(DOWN)
    wait_for(lambda: bridge.dropped == 1)
    with broker(tmp_path, port):
        wait_for(lambda: retained(port) == "down")


def test_computers_with_one_topic_keep_each_others_connections(tmp_path: Path, opened: Open) -> None:
    port, log = free_port(), tmp_path / "log"
    lines = f"allow_anonymous true\nlog_dest file {log}\nuser root\n"
    with broker(tmp_path, port, lines), subscribed(port, "touchd/#") as messages:
        for number in (1, 2):
            put(opened(port), number, messages)
        connected = re.findall(rf"as touchd_{socket.gethostname()}_touchd_pad_", log.read_text())
    assert len(connected) == 2


def test_what_a_broker_refuses_is_named_once(
    tmp_path: Path, opened: Open, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "acl").write_text("topic read #\ntopic write touchd/pad/state\n")
    port = free_port()
    with broker(tmp_path, port, f"allow_anonymous true\nacl_file {tmp_path}/acl\nuser root\n"):
        bridge = opened(port)
        for number in range(20):
            bridge.put(touch(number))
        bridge.stop(WITHIN_S)
    refused = "mqtt: the peer refused something (touchd/pad/event: Not authorized)"
    assert [line for line in caplog.messages if "refused" in line] == [refused]


def test_a_broker_without_mqtt_5_gets_mqtt_3(port: int, messages: list[Any], opened: Open) -> None:
    def refuse_5(client: socket.socket, goes_on: Callable[[], bool]) -> None:
        greeting = client.recv(65536)
        if greeting[8] == 5:
            client.sendall(b"\x20\x02\x00\x01")
            return
        attackers.forward(client, port, goes_on, greeting)

    old = free_port()
    with attackers.server(old, refuse_5):
        put(opened(old), 1, messages)


def test_an_event_that_is_acknowledged_late_comes_once(
    port: int, messages: list[Any], opened: Open, caplog: pytest.LogCaptureFixture
) -> None:
    is_slow: list[bool] = []

    def delay(client: socket.socket, goes_on: Callable[[], bool]) -> None:
        attackers.forward(client, port, goes_on, hold=lambda: bool(is_slow))

    slow = free_port()
    with attackers.server(slow, delay):
        bridge = opened(slow)
        put(bridge, 1, messages)
        is_slow.append(True)
        bridge.put(touch(2))
        time.sleep(0.2)
        is_slow.clear()
        put(bridge, 3, messages)
    assert [decode(text) for text in payloads(messages)] == [touch(1), touch(2), touch(3)]
    assert "ERROR" not in {record.levelname for record in caplog.records}


@pytest.mark.parametrize(
    ("greeting", "reason"),
    [
        (b"\x20\x03\x00\x00\x00", "(the connection was closed)"),
        (b"", "(the connection was closed before a greeting: is it a broker, and does it want TLS?)"),
        pytest.param(
            b"\x20\x03\x00\x00\x00\x30\xff\xff\x7f" + bytes(100_000),
            "(it sends more than touchd asks for)",
            id="a flood",
        ),
        (b"\x20\x03\x00\x87\x00", "(Not authorized)"),
        (b"\x20\x03\x00\x9c\x00", "(Use another server)"),
        (b"\x20\x03\x00\x00\x00\xe0\x02\x8b\x00", "(Server shutting down)"),
        (b"\x20\x0b\x00\x97\x08\x1f\x00\x05a\n\x1b[m", "(Quota exceeded: a"),
    ],
)
def test_a_lost_broker_is_reported_with_its_reason(
    opened: Open, greeting: bytes, reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    port, versions = free_port(), list[bytes]()

    def hang_up(client: Any, _goes_on: Callable[[], bool]) -> None:
        versions.append(client.recv(65536)[8:9])
        client.sendall(greeting)

    with attackers.server(port, hang_up):
        opened(port)
        wait_for(lambda: "is away" in caplog.text and len(versions) > 1)
    assert reason in caplog.text
    assert "Unspecified" not in caplog.text
    # A broker that answers knows MQTT 5.
    assert (versions[1] == b"\x05") is bool(greeting)
