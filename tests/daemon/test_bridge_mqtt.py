"""MQTT on a real mosquitto: topics, state and last will, pressure, login, TLS, Home Assistant."""

import itertools
import json
import os
import select
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest
from rigs.made_events import PREDICTION, touch
from rigs.peers import PAD, broker, frame, needs_mosquitto, subscribed
from rigs.running_daemon import Daemon
from rigs.scripted_model import Scripted
from rigs.sockets import free_port
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.app.config import PadSettings, SceneSettings, Settings
from touchd.daemon.app.parts import make_parts
from touchd.daemon.bridges.bridge import Bridge, BridgeError
from touchd.daemon.bridges.bridges import make_bridges
from touchd.daemon.bridges.retained import OnBroker, Retained, file_for
from touchd.daemon.bridges.settings import MqttSettings
from touchd.daemon.path.events import SensorEvent, encode
from touchd.daemon.sinks.touches import decode
from touchd.drivers.frame import NO_TOUCH
from touchd.drivers.queue import Signal

MQTTv311 = pytest.importorskip("paho.mqtt.client").MQTTv311
pytestmark = needs_mosquitto

MODELS = {"pad": Scripted()}
UP = SensorEvent(state="up", time="2026-11-20T10:00:00.000Z")


@pytest.fixture(autouse=True)
def own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Remember retained topics in a folder of the test."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    """A broker without login."""
    port = free_port()
    with broker(tmp_path, port):
        yield port


Open = Callable[..., Bridge]


def made(port: int, **settings: Any) -> list[Bridge]:
    scene = SceneSettings(gestures=settings.pop("gestures", None))
    mqtt = MqttSettings(**({"host": "127.0.0.1", "port": port} | settings))
    return list(make_bridges(Settings(mqtt=mqtt, scene=scene), MODELS, Path(), None))


@pytest.fixture
def opened(port: int) -> Iterator[Open]:
    """Opens bridges with given settings; closes them after the test."""
    with ExitStack() as closing:

        def open_bridge(at: int = port, **settings: Any) -> Bridge:
            (bridge,) = made(at, **settings)
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
    bridge.put(SensorEvent(state="down", time=UP.time, reason="unplugged"))
    bridge.put(UP)
    wait_for(lambda: retained(port) == "up")
    bridge.stop(WITHIN_S)
    assert retained(port) == "stopped"


def retained(port: int) -> str:
    with subscribed(port, "touchd/pad/state") as messages:
        wait_for(lambda: bool(messages))
        return str(messages[0].payload.decode()) if messages[0].retain else ""


def test_a_daemon_that_is_killed_leaves_its_last_will(port: int, tmp_path: Path) -> None:
    with Daemon(tmp_path, mqtt=MqttSettings(host="127.0.0.1", port=port)) as daemon:
        wait_for(lambda: retained(port) == "up")
        daemon.process.kill()
        wait_for(lambda: retained(port) == "lost")


def test_a_reconnect_replaces_the_last_will_of_the_old_connection(port: int, opened: Open) -> None:
    with socket.create_server(("127.0.0.1", 0)) as door:
        carried: list[tuple[socket.socket, socket.socket]] = []

        def carry(source: socket.socket, sink: socket.socket) -> None:
            with suppress(OSError):
                while data := source.recv(4096):
                    sink.sendall(data)

        def let_in() -> None:
            with suppress(OSError):
                while True:
                    ends = door.accept()[0], socket.create_connection(("127.0.0.1", port))
                    carried.append(ends)
                    for pair in (ends, ends[::-1]):
                        threading.Thread(target=carry, args=pair, daemon=True).start()

        threading.Thread(target=let_in, daemon=True).start()
        bridge = opened(door.getsockname()[1])
        bridge.put(UP)
        wait_for(lambda: retained(port) == "up")
        # The router between them forgets the connection: touchd notices, the broker does not.
        touchds_end, brokers_end = carried[0]
        touchds_end.shutdown(socket.SHUT_RDWR)
        wait_for(lambda: len(carried) == 2)
        # The socket is readable once the broker has closed its end.
        wait_for(lambda: bool(select.select([brokers_end], [], [], 0)[0]))
        wait_for(lambda: retained(port) == "up")
        bridge.stop(WITHIN_S)
        for end in itertools.chain.from_iterable(carried):
            end.close()


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
            time.sleep(0.5)
            password.write_text("s3cret")
            wait_for(lambda: "connected to" in caplog.text)
            said = list(caplog.messages)
    parts = ("cannot be reached", "answers (after", "Not authorized", "connected to")
    for line, part in zip(said, parts, strict=True):
        assert part in line


def test_a_password_file_that_cannot_be_read_is_refused(port: int) -> None:
    with pytest.raises(BridgeError, match=r"mqtt\.password_file: /nowhere cannot be read"):
        made(port, user="robot", password_file="/nowhere")


def test_a_password_file_that_is_a_pipe_does_not_block(port: int, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "password")
    with pytest.raises(BridgeError, match="is empty"):
        made(port, user="robot", password_file=str(tmp_path / "password"))


def test_home_assistant_gets_told_answers_as_events(port: int, opened: Open) -> None:
    jinja2 = pytest.importorskip("jinja2")
    with subscribed(port, "homeassistant/#") as messages:
        opened(topic="lab/nao1", discovery="homeassistant")
        wait_for(lambda: bool(messages))
    (message,) = messages
    assert message.topic == "homeassistant/event/lab_nao1_pad/config"
    entity = json.loads(message.payload)
    assert entity["state_topic"] == "lab/nao1/pad/event"
    template = jinja2.Environment().from_string(entity["value_template"])
    event = json.loads(template.render(value_json=json.loads(encode(PREDICTION))))
    assert event["event_type"] in entity["event_types"]
    assert NO_TOUCH not in entity["event_types"]
    assert event == {"event_type": "stroke", "confidence": 0.81, "stage": "early", "touch": 7}
    assert template.render(value_json=json.loads(encode(touch(1)))) == ""
    available = jinja2.Environment().from_string(entity["availability_template"])
    states = ("up", "degraded", "down", "stopped", "lost")
    assert [available.render(value=state) for state in states] == ["online"] * 2 + ["offline"] * 3


def publish(port: int, topic: str, payload: str, retain: bool = True) -> None:
    """Publish as another program would."""
    import paho.mqtt.publish

    paho.mqtt.publish.single(topic, payload, 1, retain, "127.0.0.1", port)


def all_retained(port: int) -> dict[str, str]:
    """Return the broker's retained messages by topic."""
    with subscribed(port, "#") as messages:
        publish(port, "end", "", retain=False)
        wait_for(lambda: any(message.topic == "end" for message in messages))
    return {message.topic: message.payload.decode() for message in messages if message.retain}


ANNOUNCED = "homeassistant/event/touchd_pad/config"


Configured = Callable[..., tuple[Bridge, ...]]


@pytest.fixture
def configured(tmp_path: Path) -> Iterator[Configured]:
    """Starts the bridges of a configuration file of this name, which is written if it is missing."""
    started: list[Bridge] = []

    def configure(name: str, mqtt: MqttSettings | None, **settings: Any) -> tuple[Bridge, ...]:
        (tmp_path / name).touch()
        parts = make_parts(
            Settings(mqtt=mqtt, journal=None, **settings), print, tuple, Signal(), tmp_path / name
        )
        bridges = parts.bridges
        started.extend(bridges)
        for bridge in bridges:
            bridge.start()
        return bridges

    yield configure
    stop(*started)


def stop(*bridges: Bridge) -> None:
    for bridge in bridges:
        bridge.stop(2.0)


def announced(port: int, **settings: Any) -> MqttSettings:
    return MqttSettings(**({"host": "127.0.0.1", "port": port, "discovery": "homeassistant"} | settings))


OTHERS = "lab/other/pad/state"


@pytest.mark.parametrize("change", ["pad", "topic", "discovery", "section"])
def test_what_a_former_configuration_left_is_cleared(port: int, configured: Configured, change: str) -> None:
    publish(port, OTHERS, "up")
    before = configured("a.yaml", announced(port))
    wait_for(lambda: all_retained(port).keys() == {"touchd/pad/state", ANNOUNCED, OTHERS})
    stop(*before)
    left: set[str] = set()
    match change:
        case "pad":
            configured("a.yaml", announced(port), sensors={"arm": PadSettings(port="/dev/arm")})
            left = {"touchd/arm/state", "homeassistant/event/touchd_arm/config"}
        case "topic":
            configured("a.yaml", announced(port, topic="lab/nao1"))
            left = {"lab/nao1/pad/state", "homeassistant/event/lab_nao1_pad/config"}
        case "discovery":
            configured("a.yaml", announced(port, discovery=None))
            left = {"touchd/pad/state"}
        case _:
            configured("a.yaml", None)
    wait_for(lambda: all_retained(port).keys() == {*left, OTHERS})


def test_what_a_moved_configuration_left_is_cleared(
    port: int, configured: Configured, tmp_path: Path
) -> None:
    before = configured("a.yaml", announced(port))
    wait_for(lambda: ANNOUNCED in all_retained(port))
    stop(*before)
    (tmp_path / "a.yaml").rename(tmp_path / "b.yaml")
    configured("b.yaml", announced(port, topic="lab/nao1"))
    moved = {"lab/nao1/pad/state", "homeassistant/event/lab_nao1_pad/config"}
    wait_for(lambda: all_retained(port).keys() == moved)


def test_what_a_moved_configuration_still_uses_stays(
    port: int, configured: Configured, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    before = configured("a.yaml", announced(port))
    wait_for(lambda: ANNOUNCED in all_retained(port))
    stop(*before)
    (tmp_path / "a.yaml").rename(tmp_path / "b.yaml")
    with caplog.at_level("INFO"):
        configured("b.yaml", announced(port, discovery=None))
        wait_for(lambda: all_retained(port) == {"touchd/pad/state": "down"})
    assert f"cleared {ANNOUNCED}" in caplog.text
    assert "cleared touchd/pad/state" not in caplog.text


def test_a_former_broker_is_cleared_once_it_is_there_and_forgotten(
    port: int, configured: Configured, tmp_path: Path
) -> None:
    other = free_port()
    lines = f"allow_anonymous true\npersistence true\npersistence_location {tmp_path}/\nuser root\n"
    with broker(tmp_path, other, lines):
        before = configured("a.yaml", announced(other))
        wait_for(lambda: all_retained(other).keys() == {"touchd/pad/state", ANNOUNCED})
        stop(*before)
    stop(*configured("a.yaml", announced(port)))
    _, clearing = configured("a.yaml", announced(port))
    with broker(tmp_path, other, lines):
        wait_for(lambda: all_retained(other) == {})
        wait_for(lambda: len(configured("a.yaml", announced(port))) == 1)
        stop(clearing)


def test_an_address_without_a_broker_is_not_remembered(
    port: int, configured: Configured, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    refusing = free_port()
    with broker(tmp_path, refusing, "allow_anonymous true\nretain_available false\n"):
        for wrong, why in ((free_port(), "Connection refused"), (refusing, "Retain not supported")):
            before = configured("a.yaml", announced(wrong))
            wait_for(lambda why=why: why in caplog.text)
            stop(*before)
    assert len(configured("a.yaml", announced(port))) == 1


def test_a_former_topic_is_cleared_with_the_present_login(tmp_path: Path, configured: Configured) -> None:
    port = free_port()
    with broker(tmp_path, port):
        before = configured("a.yaml", announced(port, topic="old", discovery=None))
        wait_for(lambda: all_retained(port).keys() == {"old/pad/state"})
        stop(*before)
    password = tmp_path / "password"
    password.write_text("s3cret")
    with broker(tmp_path, port, only_robot(tmp_path)):
        login = {"user": "robot", "password_file": str(password)}
        _, clearing = configured("a.yaml", announced(port, topic="new", discovery=None, **login))
        wait_for(clearing._peer_is_there.is_set)


def test_the_late_last_will_of_a_former_configuration_is_cleared(port: int, configured: Configured) -> None:
    before = configured("a.yaml", announced(port, topic="old", discovery=None))
    wait_for(lambda: all_retained(port).keys() == {"old/pad/state"})
    stop(*before)
    configured("a.yaml", announced(port, topic="new", discovery=None))
    wait_for(lambda: all_retained(port).keys() == {"new/pad/state"})
    publish(port, "old/pad/state", "lost")
    wait_for(lambda: all_retained(port).keys() == {"new/pad/state"})


def test_another_configuration_of_this_computer_is_not_cleared(port: int, configured: Configured) -> None:
    bridges: list[Bridge] = []
    for topic in ("one", "two"):
        bridges += configured(f"{topic}.yaml", announced(port, topic=topic, discovery=None))
    for bridge in bridges:
        bridge.put(UP)
    wait_for(lambda: all_retained(port) == {"one/pad/state": "up", "two/pad/state": "up"})
    stop(*bridges)
    configured("two.yaml", None)
    wait_for(lambda: all_retained(port) == {"one/pad/state": "stopped"})


def test_a_former_password_file_that_is_gone_stops_nothing(
    port: int, configured: Configured, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "password").write_text("guess")
    before = configured("a.yaml", announced(port, user="robot", password_file=str(tmp_path / "password")))
    wait_for(lambda: ANNOUNCED in all_retained(port))
    stop(*before)
    (tmp_path / "password").unlink()
    assert configured("a.yaml", None) == ()
    assert "touchd/pad/state" in caplog.text
    assert "cannot be read" in caplog.text


def test_a_damaged_memory_of_topics_does_not_matter(tmp_path: Path) -> None:
    config = tmp_path / "a.yaml"
    config.touch()
    on_broker = OnBroker(MqttSettings(), ("b",))

    def restarted(folder: Path, path: Path) -> tuple[OnBroker, ...]:
        retained = Retained(folder, path, on_broker)
        retained.reached()
        return retained.former

    for content in (b"", b"\0" * 100, b'{"a": 1}', b"[" * 100_000, b'{"config": "\\u0000"}'):
        for file in (file_for(config, tmp_path), tmp_path / "mqtt-another.json"):
            file.write_bytes(content)
        assert restarted(tmp_path, config) == ()
    assert Retained(tmp_path, config, None).former == (on_broker,)
    for folder, path in ((Path("/proc/no"), config), (tmp_path, Path(os.fsdecode(b"/\xff.yaml")))):
        assert restarted(folder, path) == ()


@pytest.mark.parametrize("ending", ["stopped", "lost", ""])
def test_the_living_daemons_state_stands(port: int, opened: Open, ending: str) -> None:
    bridge = opened(discovery="homeassistant")
    bridge.put(UP)
    wait_for(lambda: all_retained(port).get("touchd/pad/state") == "up")
    publish(port, "touchd/pad/state", ending)
    wait_for(lambda: all_retained(port).get("touchd/pad/state") == "up")
    publish(port, ANNOUNCED, "")
    wait_for(lambda: ANNOUNCED in all_retained(port))


def test_two_daemons_on_one_topic_are_noticed(
    port: int, opened: Open, caplog: pytest.LogCaptureFixture
) -> None:
    opened().put(UP)
    wait_for(lambda: all_retained(port) == {"touchd/pad/state": "up"})
    other = opened()
    other.put(UP)
    # Each of them says it once.
    wait_for(lambda: caplog.text.count("another touchd publishes to touchd/pad, too") == 2)
    other.stop(2.0)
    wait_for(lambda: all_retained(port) == {"touchd/pad/state": "up"})
    assert caplog.text.count("another touchd") == 2


def test_one_daemon_alone_is_not_two(port: int, opened: Open, caplog: pytest.LogCaptureFixture) -> None:
    bridge = opened(discovery="homeassistant")
    for number in range(1, 30):
        bridge.put(SensorEvent(state="up" if number % 2 else "degraded", time=UP.time))
    publish(port, "homeassistant/status", "online", retain=False)
    wait_for(lambda: all_retained(port).get("touchd/pad/state") == "up" and not len(bridge._items))
    assert "another touchd" not in caplog.text


def test_home_assistants_start_is_answered(port: int, opened: Open) -> None:
    opened(discovery="homeassistant")
    wait_for(lambda: ANNOUNCED in all_retained(port))
    with subscribed(port, "#") as messages:
        wait_for(lambda: len(messages) >= 2)
        messages.clear()
        publish(port, "homeassistant/status", "online", retain=False)
        wait_for(lambda: {message.topic for message in messages} >= {ANNOUNCED, "touchd/pad/state"})


def test_state_and_announcement_come_again(port: int, opened: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchd.daemon.bridges.mqtt.AGAIN_S", 0.5)
    opened(discovery="homeassistant")
    with subscribed(port, "#") as messages:
        wait_for(lambda: len(payloads(messages, "touchd/pad/state")) >= 3)
        assert len(payloads(messages, ANNOUNCED)) >= 2


def test_what_the_broker_cannot_take_is_dropped_at_once(
    tmp_path: Path, opened: Open, caplog: pytest.LogCaptureFixture
) -> None:
    port = free_port()
    lines = "allow_anonymous true\nmax_packet_size 250\n"
    with broker(tmp_path, port, lines), subscribed(port, "touchd/pad/event") as messages:
        bridge = opened(port, discovery="homeassistant")
        for number in range(1, 21):
            bridge.put(touch(number))
            bridge.put(PREDICTION)
        wait_for(lambda: len(messages) == 20)
        # The announcement, too.
        assert bridge.refused == 21
        assert bridge._connection_number == 1
        # To the byte.
        fits = 250 - len("touchd/pad/event") - 8
        size = len(encode(SensorEvent(state="up", time=UP.time, reason="")))
        for extra in (0, 1):
            bridge.put(SensorEvent(state="up", time=UP.time, reason="x" * (fits - size + extra)))
        wait_for(lambda: bridge.refused == 22)
        wait_for(lambda: len(messages) == 21)
        assert len(messages[-1].payload) == fits
        bridge.stop(2.0)
    assert "the broker takes 250 at most" in caplog.text
    assert "is away" not in caplog.text


def test_a_broker_that_cannot_say_its_limit_does_not_lose_the_small_events(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    port = free_port()
    lines = "allow_anonymous true\nmax_packet_size 250\n"
    with broker(tmp_path, port, lines), subscribed(port, "touchd/pad/event") as messages:
        (bridge,) = made(port, discovery="homeassistant")
        # As after a broker has refused MQTT 5.
        vars(bridge)["_version"] = MQTTv311
        bridge.start()
        try:
            for number in range(1, 21):
                bridge.put(PREDICTION)
                bridge.put(touch(number))
            wait_for(lambda: len(messages) >= 2)
            # Connections ended over the announcement and one more prediction, and none after that.
            ended = bridge._connection_number
            wait_for(lambda: len(messages) == 20)
            assert bridge._connection_number == ended
        finally:
            bridge.stop(2.0)
    assert "the broker takes" not in caplog.text
    assert "perhaps takes" in caplog.text


def test_an_announcement_over_an_ended_connection_does_not_end_the_bridge() -> None:
    from touchd.daemon.bridges.mqtt import Client, MqttBridge

    bridge, client = MqttBridge(announced(1), "pad"), Client("name", MQTTv311)
    vars(bridge)["_version"] = MQTTv311
    # It was never connected, so paho refuses the announcement.
    bridge._publish_announcement(client)
    for _ in range(3):
        bridge._learn(client, 100, is_taken=False)
    assert bridge._seems_longest == 75


def test_a_return_of_the_broker_is_said_once(
    tmp_path: Path, opened: Open, caplog: pytest.LogCaptureFixture
) -> None:
    port = free_port()
    with caplog.at_level("INFO"):
        with broker(tmp_path, port):
            bridge = opened(port)
            wait_for(lambda: "connected to" in caplog.text)
        wait_for(lambda: "cannot be reached" in caplog.text)
        caplog.clear()
        with broker(tmp_path, port):
            wait_for(bridge._peer_is_there.is_set)
            time.sleep(0.3)
            bridge.stop(2.0)
    assert caplog.text.count("connected to") == 1


@pytest.mark.slow
def test_one_broker_carries_fifty_pads(port: int) -> None:
    from touchd.daemon.bridges.mqtt import MqttBridge

    pads, touches, each = 50, 20, 5
    with subscribed(port, "touchd/+/event") as messages:
        settings = MqttSettings(host="127.0.0.1", port=port)
        opened = {name: MqttBridge(settings, name) for name in (f"pad{number}" for number in range(pads))}
        for bridge in opened.values():
            bridge.start()
        wait_for(lambda: all(bridge._peer_is_there.is_set() for bridge in opened.values()), 30.0)
        # Five events a touch and a touch a second on every pad: more than people can produce.
        began_s = time.monotonic()
        for number in range(touches):
            for _ in range(each):
                for pad, bridge in opened.items():
                    bridge.put(msgspec.structs.replace(touch(number), pad=pad))
            time.sleep(max(0.0, began_s + number + 1 - time.monotonic()))
        wait_for(lambda: len(messages) == pads * touches * each, 30.0)
        assert sum(bridge.dropped for bridge in opened.values()) == 0
        for bridge in opened.values():
            bridge.stop(2.0)
