"""Peers that send without end or refuse what they get: memory stays, and the log says why, briefly."""

import json
import resource
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

import pytest
from rigs import attackers
from rigs.expectations import DEMO, stream_of
from rigs.made_events import touch
from rigs.peers import broker, needs_mosquitto, subscribed
from rigs.running_daemon import Daemon
from rigs.sockets import free_port
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.bridges.bridge import Bridge
from touchd.daemon.bridges.settings import MqttSettings, RosbridgeSettings
from touchd.daemon.config import SensorSettings
from touchd.daemon.events import SensorEvent
from touchd.daemon.setup.destinations import encoder_for
from touchd.drivers.fakes.fake_port import FakePort

MOST_GROWTH_MB = 20.0
MOST_LOG_LINES = 40
SETTLING_S = 1.5

Configure = Callable[[int], dict[str, Any]]


def mqtt(port: int) -> dict[str, Any]:
    return {"mqtt": MqttSettings(host="127.0.0.1", port=port, pressure_hz=500)}


def rosbridge(port: int) -> dict[str, Any]:
    url = f"ws://127.0.0.1:{port}/?token=s3cret"
    return {"rosbridge": RosbridgeSettings(url=url, pressure_hz=500)}


SERVERS: dict[str, tuple[str, Configure, attackers.Attack]] = {
    "mqtt, QoS 2 without end": ("paho.mqtt", mqtt, attackers.unfinished_publishes),
    "mqtt, a message of 256 MiB": ("paho.mqtt", mqtt, attackers.huge_publish),
    "mqtt, a broker that reads nothing": ("paho.mqtt", mqtt, attackers.takes_nothing),
    "mqtt, zeros": ("paho.mqtt", mqtt, attackers.zeros),
    "rosbridge, empty fragments": ("websockets", rosbridge, attackers.empty_fragments),
    "rosbridge, pings": ("websockets", rosbridge, attackers.pings),
    "rosbridge, refusals": ("websockets", rosbridge, attackers.statuses),
    "rosbridge, an endless answer": ("websockets", rosbridge, attackers.endless_answer),
    "rosbridge, an endless header": ("websockets", rosbridge, attackers.endless_header),
    "rosbridge, zeros": ("websockets", rosbridge, attackers.zeros),
}


def resident_mb(pid: int) -> float:
    """Return the memory of a process and of those that it started."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6 + sum(resident_mb(int(child)) for child in children)


def growth_mb(daemon: Daemon, seconds: float) -> float:
    """Return by how much its memory grew at most, once it had settled."""
    wait_for(lambda: daemon.events)
    time.sleep(SETTLING_S)
    first_mb = most_mb = resident_mb(daemon.process.pid)
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        time.sleep(0.05)
        most_mb = max(most_mb, resident_mb(daemon.process.pid))
    return most_mb - first_mb


def endured(folder: Path, attack: AbstractContextManager[Any], seconds: float, **settings: Any) -> str:
    """Run a daemon under an attack, check memory and log, and return the log."""
    encode = encoder_for(SensorSettings())
    with (
        attack,
        FakePort(stream_of(DEMO), encode, speed=4.0, loop=True) as pad,
        Daemon(folder, pad, **settings) as daemon,
    ):
        grew_mb = growth_mb(daemon, seconds)
        asked_s = time.monotonic()
        assert daemon.stop() == 0
        assert time.monotonic() - asked_s < WITHIN_S / 20
    assert grew_mb < MOST_GROWTH_MB
    assert daemon.log.count("\n") < MOST_LOG_LINES
    assert "Traceback" not in daemon.log
    assert "s3cret" not in daemon.log
    assert daemon.log.replace("\n", "").isprintable()
    return daemon.log


@pytest.mark.parametrize("seconds", [4.0, pytest.param(60.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", SERVERS)
def test_no_server_decides_how_much_memory_is_used(tmp_path: Path, name: str, seconds: float) -> None:
    library, configure, attack = SERVERS[name]
    pytest.importorskip(library)
    port = free_port()
    endured(tmp_path, attackers.server(port, attack), seconds, **configure(port))


@pytest.fixture
def port() -> int:
    return free_port()


def opened(closing: ExitStack, port: int, **settings: Any) -> Bridge:
    """Return a started MQTT bridge."""
    from touchd.daemon.bridges.mqtt import MqttBridge

    bridge = MqttBridge(MqttSettings(host="127.0.0.1", port=port, **settings), "pad")
    bridge.start()
    closing.callback(bridge.stop, 2.0)
    return bridge


@needs_mosquitto
def test_what_a_broker_does_not_allow_is_counted_and_named(
    tmp_path: Path, port: int, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("paho.mqtt")
    (tmp_path / "acl").write_text("topic read #\ntopic write touchd/pad/state\n")
    lines = f"allow_anonymous true\nacl_file {tmp_path}/acl\nuser root\n"
    with broker(tmp_path, port, lines), ExitStack() as closing:
        bridge = opened(closing, port)
        for number in range(20):
            bridge.put(touch(number))
        wait_for(lambda: bridge.refused == 20)
    said = [line for line in caplog.messages if "refused" in line]
    assert said[0] == "mqtt: the peer refused something (Not authorized)"
    assert said[1:] == ["mqtt: 19 more were refused until the end"]


@needs_mosquitto
def test_one_event_that_is_too_large_holds_up_no_other(
    tmp_path: Path, port: int, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("paho.mqtt")
    lines = "allow_anonymous true\nmax_packet_size 300\n"
    with (
        broker(tmp_path, port, lines),
        subscribed(port, "touchd/pad/event") as messages,
        ExitStack() as closing,
    ):
        bridge = opened(closing, port)
        bridge.put(touch(1))
        bridge.put(SensorEvent(state="down", time="2026-11-20T10:00:00.000Z", reason="x" * 400))
        bridge.put(touch(2))
        wait_for(lambda: len(messages) >= 2)
    assert [json.loads(message.payload)["touch"] for message in messages] == [1, 2]
    assert bridge.refused == 1
    assert "sensor: 3 connections ended while it was sent" in caplog.text
    assert "Packet too large" in caplog.text


def test_a_broker_that_knows_only_mqtt_3_is_spoken_to_in_it(port: int) -> None:
    pytest.importorskip("paho.mqtt")
    versions: list[int] = []

    def old_broker(client: Any, _goes_on: Callable[[], bool]) -> None:
        versions.append(client.recv(65536)[8])
        if versions[-1] != 4:
            client.sendall(b"\x20\x02\x00\x01")
            return
        client.sendall(attackers.CONNACK)
        while said := client.recv(65536):
            if said[0] & 0xF0 == 0x30:
                # The packet's number stands behind its topic.
                at = 4 + int.from_bytes(said[2:4], "big")
                client.sendall(attackers.PUBACK + said[at : at + 2])

    with attackers.server(port, old_broker), ExitStack() as closing:
        bridge = opened(closing, port)
        wait_for(bridge._peer_is_there.is_set)
    assert versions == [5, 4]


@pytest.mark.parametrize(
    ("greeting", "reason"),
    [
        (b"\x20\x03\x00\x00\x00", "(the connection was closed)"),
        (b"", "(the connection was closed before a greeting: is it a broker, and does it want TLS?)"),
        (b"\x20\x03\x00\x87\x00", "(Not authorized)"),
        (b"\x20\x0b\x00\x97\x08\x1f\x00\x05a\n\x1b[m", "(Quota exceeded: a"),
    ],
)
def test_why_a_broker_is_away_is_said_in_words(
    port: int, greeting: bytes, reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("paho.mqtt")

    def hang_up(client: Any, _goes_on: Callable[[], bool]) -> None:
        client.recv(65536)
        client.sendall(greeting)

    with attackers.server(port, hang_up), ExitStack() as closing:
        opened(closing, port)
        wait_for(lambda: "is away" in caplog.text)
    assert reason in caplog.text
    assert "Unspecified" not in caplog.text


def test_what_a_rosbridge_refuses_is_counted_and_said_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("websockets")
    port = free_port()
    refusal = '{"op":"status","level":"error","msg":"publish: not allowed\\n\\u001b[31m","id":"x"}'

    def refuse(client: Any, goes_on: Callable[[], bool]) -> None:
        attackers.welcome(client)
        while goes_on() and client.recv(65536):
            client.sendall(attackers.text(refusal.encode()))
            # Neither a status nor JSON, nor what can be read at all.
            client.sendall(attackers.text(b'{"op":"publish","msg":{}}') + attackers.text(b"[" * 60_000))

    from touchd.daemon.bridges.rosbridge import RosbridgeBridge

    with attackers.server(port, refuse):
        bridge = RosbridgeBridge(RosbridgeSettings(url=f"ws://127.0.0.1:{port}"), "pad")
        bridge.start()
        for number in range(20):
            bridge.put(touch(number))
            time.sleep(0.02)
        wait_for(lambda: bridge.refused >= 5)
        bridge.stop(2.0)
    said = [line for line in caplog.messages if "refused" in line]
    assert len(said) == 2
    assert said[0].startswith("rosbridge: the peer refused something (publish: not allowed")
    assert said[1].endswith("more were refused until the end")
