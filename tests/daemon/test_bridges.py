"""Every bridge: it never blocks, reconnects to its peer, and stops when asked."""

import itertools
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest
from rigs.made_events import touch
from rigs.peers import PAD, LslPeer, MqttPeer, Peer, Ros2Peer, RosbridgePeer, frame, needs_mosquitto
from rigs.wait import WITHIN_S, wait_for
from websockets.utils import accept_key

from touchd.daemon.bridges.bridge import Bridge

KINDS = {
    "mqtt": ("paho.mqtt", MqttPeer, [needs_mosquitto]),
    "lsl": ("pylsl", LslPeer, []),
    "ros2": ("cyclonedds", Ros2Peer, []),
    "rosbridge": ("websockets", RosbridgePeer, []),
}
ALL = [pytest.param(kind, marks=marks) for kind, (_, _, marks) in KINDS.items()]
CONNECTING = [ALL[0], ALL[3]]
# Time that a busy machine may need for calls that do not wait.
AT_ONCE_S = 2.0
CONNACK = b"\x20\x02\x00\x00"
WELCOME = (
    b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Accept: %s\r\n\r\n"
)


@pytest.fixture
def peer(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Peer]:
    library, kind, _ = KINDS[request.param]
    pytest.importorskip(library)
    before = set(threading.enumerate())
    with closing(kind(tmp_path)) as made:
        yield made
    # Even after a failed test no thread is left.
    started = set(threading.enumerate()) - before
    wait_for(lambda: not any(thread.is_alive() for thread in started if thread.name.startswith("touchd-")))


def put_until_received(peer: Peer, bridge: Bridge) -> None:
    """Put events until one arrives; a peer for which nobody queues misses those sent before it was found."""
    received = len(peer.received)
    while len(peer.received) == received:
        bridge.put(touch(1))
        time.sleep(0.05)


@pytest.mark.parametrize("peer", ALL, indirect=True)
def test_events_arrive_again_after_the_peer_died(peer: Peer) -> None:
    bridge = peer.bridge()
    for _ in range(2):
        peer.start()
        put_until_received(peer, bridge)
        received = len(peer.received)
        bridge.put(touch(2))
        peer.await_received(received + 1)
        peer.stop()


@pytest.mark.parametrize("peer", CONNECTING, indirect=True)
def test_while_the_peer_is_away_the_oldest_events_are_dropped(
    peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Bridge, "capacity", 10)
    bridge = peer.bridge()
    began_s = time.monotonic()
    for number in range(50):
        bridge.put(touch(number))
    assert time.monotonic() - began_s < AT_ONCE_S
    assert 39 <= bridge.dropped <= 40
    peer.start()
    peer.await_received(10)
    assert f'"touch":{49},' in peer.received[-1]
    assert len(peer.received) + bridge.dropped == 50


@pytest.mark.parametrize("peer", ALL, indirect=True)
def test_without_a_peer_neither_put_nor_stop_waits(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Bridge, "capacity", 5)
    bridge = peer.bridge()
    slowest_s = 0.0
    for number in range(2000):
        began_s = time.monotonic()
        bridge.put(touch(number))
        bridge.put_frame(frame(number), PAD)
        slowest_s = max(slowest_s, time.monotonic() - began_s)
    assert slowest_s < AT_ONCE_S
    began_s = time.monotonic()
    bridge.stop(1.0)
    bridge.stop(0.1)
    assert time.monotonic() - began_s < 1.0 + AT_ONCE_S


def let_in_and_hang_up(port: int, sizes: list[int], ended: threading.Event) -> None:
    """Accept MQTT and websocket clients, read what they send, and hang up once they pause."""
    with socket.create_server(("127.0.0.1", port)) as door:
        door.settimeout(0.1)
        while not ended.is_set():
            with suppress(OSError), door.accept()[0] as client:
                client.settimeout(0.2)
                asked = client.recv(65536)
                key = re.search(rb"Sec-WebSocket-Key: (.*)\r", asked)
                client.sendall(WELCOME % accept_key(key[1].decode()).encode() if key else CONNACK)
                sizes.append(0)
                client.settimeout(0.1)
                while said := client.recv(65536):
                    sizes[-1] += len(said)


@pytest.mark.parametrize("peer", CONNECTING, indirect=True)
def test_a_peer_that_hangs_up_is_retried_slowly(peer: Peer, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    sizes: list[int] = []
    ended = threading.Event()
    door = threading.Thread(target=let_in_and_hang_up, args=(peer.port, sizes, ended))
    door.start()
    bridge = peer.bridge()
    bridge.put(touch(1))
    wait_for(lambda: len(sizes) >= 4)
    time.sleep(2.0)
    began_s = time.monotonic()
    bridge.stop(1.0)
    assert time.monotonic() - began_s < 1.0 + AT_ONCE_S
    ended.set()
    door.join()
    assert len(sizes) <= 12
    # Unacknowledged messages do not pile up: each connection carries the state and one event.
    assert max(sizes) < 500
    told = [
        record.getMessage() for record in caplog.records if record.name.startswith("touchd.daemon.bridges")
    ]
    assert 1 <= sum("connected" in line for line in told) <= 2
    assert 1 <= sum("is away" in line for line in told) <= 2


@pytest.mark.parametrize("peer", CONNECTING, indirect=True)
def test_a_silent_peer_does_not_block_the_bridge(peer: Peer) -> None:
    with socket.create_server(("127.0.0.1", peer.port)) as mute:
        bridge = peer.bridge()
        for number in range(20):
            bridge.put(touch(number))
        mute.settimeout(WITHIN_S)
        with mute.accept()[0]:
            began_s = time.monotonic()
            bridge.stop(1.0)
            assert time.monotonic() - began_s < 1.0 + AT_ONCE_S


@pytest.mark.parametrize("peer", [ALL[3]], indirect=True)
def test_a_peer_that_takes_nothing_is_left(
    peer: Peer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("touchd.daemon.bridges.rosbridge.UNTAKEN_MS", 300)
    with socket.socket() as door:
        door.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        door.bind(("127.0.0.1", peer.port))
        door.listen()
        bridge = peer.bridge()
        with door.accept()[0] as client:
            key = re.search(rb"Sec-WebSocket-Key: (.*)\r", client.recv(4096))
            assert key is not None
            client.sendall(WELCOME % accept_key(key[1].decode()).encode())
            numbers = itertools.count()

            def is_left() -> bool:
                # Enough to fill the kernel's buffers for the peer before the first ping.
                for number in itertools.islice(numbers, 50):
                    bridge.put_frame(frame(number, float(number)), PAD)
                return "is away" in caplog.text

            wait_for(is_left)


@pytest.mark.parametrize("peer", CONNECTING, indirect=True)
def test_stopping_sends_queued_events(peer: Peer) -> None:
    peer.start()
    bridge = peer.bridge()
    put_until_received(peer, bridge)
    received = len(peer.received)
    for number in range(100, 120):
        bridge.put(touch(number))
    bridge.stop(WITHIN_S)
    peer.await_received(received + 20)
