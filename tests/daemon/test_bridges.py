"""The contract of every bridge, whatever is at its other end."""

import itertools
import re
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any

import pytest
from rigs import attackers
from rigs.made_events import TIME
from rigs.peers import PAD, LslPeer, MqttPeer, Peer, Ros2Peer, RosbridgePeer, frame, needs_mosquitto
from rigs.sockets import free_port
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.bridges.bridge import Bridge
from touchd.daemon.path.events import Label, SensorEvent, encode
from touchd.drivers import hosts

KINDS = {
    "mqtt": ("paho.mqtt", MqttPeer, [needs_mosquitto]),
    "lsl": ("pylsl", LslPeer, []),
    "ros2": ("cyclonedds", Ros2Peer, []),
    "rosbridge": ("websockets", RosbridgePeer, []),
}
ALL = [pytest.param(kind, marks=marks) for kind, (_, _, marks) in KINDS.items()]
# Those that know whether their peer is there, and whether it has an event.
CONNECTING = [ALL[0], ALL[3]]
# Those with a process of their own.
APART = [ALL[1], ALL[2]]
# How long a daemon that ends waits for its sinks, and time that a busy machine may need beside it.
STOP_S, BUSY_S = 0.6, 3.0


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


def event(number: int) -> Label:
    """Return an event whose number every bridge sends."""
    return Label(touch=1, began=TIME, gesture=f"no{number}", time=TIME)


def numbers(peer: Peer) -> list[int]:
    """Return the numbers of the events that arrived, without 0."""
    found = (re.search(r"no([1-9]\d*)", text) for text in tuple(peer.received))
    return [int(number[1]) for number in found if number]


def put_until_received(peer: Peer, bridge: Bridge) -> None:
    """Put events until one arrives; a peer for which nobody queues misses those sent before it was found."""
    received = len(peer.received)

    def is_received() -> bool:
        bridge.put(event(0))
        return len(peer.received) > received

    wait_for(is_received, WITHIN_S)


@pytest.mark.parametrize("peer", ALL, indirect=True)
def test_events_arrive_in_order_and_again_after_the_peer_died(peer: Peer) -> None:
    bridge = peer.bridge()
    for _ in range(2):
        peer.start()
        put_until_received(peer, bridge)
        # What a peer that died had not acknowledged came again before that.
        peer.received.clear()
        # A reader of DDS keeps ten.
        for number in range(1, 10):
            bridge.put(event(number))
        wait_for(lambda: len(numbers(peer)) >= 9)
        assert numbers(peer) == list(range(1, 10))
        peer.stop()


@pytest.mark.parametrize("peer", CONNECTING, indirect=True)
def test_states_outlast_events_in_a_full_queue(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Bridge, "capacity", 5)
    monkeypatch.setattr("touchd.daemon.bridges.bridge.STALE_S", WITHIN_S)
    state = SensorEvent(state="degraded", time=TIME)
    bridge = peer.bridge()
    # The bridge holds it, and takes no other while the peer is away.
    bridge.put(event(1))
    wait_for(lambda: not len(bridge._items))
    for item in (state, *map(event, range(2, 20))):
        bridge.put(item)
    peer.start()
    wait_for(lambda: 19 in numbers(peer))
    assert encode(state).decode() in peer.received


@pytest.mark.parametrize("peer", APART, indirect=True)
def test_a_process_that_hangs_is_started_again(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchd.daemon.bridges.process.STALE_S", 0.2)
    bridge: Any = peer.bridge()
    wait_for(bridge._peer_is_there.is_set)
    hung = bridge._process
    hung.send_signal(signal.SIGSTOP)

    def is_replaced() -> bool:
        for number in range(50):
            bridge.put_frame(frame(number), PAD)
        return bridge._process is not hung

    wait_for(is_replaced)
    peer.start()
    put_until_received(peer, bridge)
    peer.stop()
    # Nor does it outlive the daemon.
    bridge._process.send_signal(signal.SIGSTOP)
    bridge.stop(STOP_S)
    assert bridge._process.wait(STOP_S / 2) == -signal.SIGKILL


@pytest.mark.parametrize("peer", CONNECTING, indirect=True)
def test_nothing_is_lost_over_a_restart_of_the_peer(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    # The peer of this test starts at a busy machine's pace.
    monkeypatch.setattr("touchd.daemon.bridges.bridge.STALE_S", WITHIN_S)
    bridge = peer.bridge()
    count = itertools.count(1)
    for _ in range(3):
        peer.start()
        for number in itertools.islice(count, 20):
            bridge.put(event(number))
        wait_for(lambda: peer.received)
        peer.stop()
        for number in itertools.islice(count, 20):
            bridge.put(event(number))
    peer.start()
    last = next(count)
    bridge.put(event(last))
    wait_for(lambda: last in numbers(peer), WITHIN_S)
    # One may come twice: it had arrived, but its acknowledgement had not.
    assert list(dict.fromkeys(numbers(peer))) == list(range(1, last + 1))


@pytest.mark.parametrize("peer", CONNECTING, indirect=True)
def test_what_is_stale_when_the_peer_returns_is_not_sent(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchd.daemon.bridges.bridge.STALE_S", 0.2)
    peer.start()
    bridge = peer.bridge()
    put_until_received(peer, bridge)
    peer.stop()
    # The first of them notices that the peer is gone.
    wait_for(lambda: bridge.put(event(1)) or not bridge._peer_is_there.is_set())
    for number in range(2, 50):
        bridge.put(event(number))
    wait_for(lambda: not len(bridge._items) and bridge.dropped >= 48)
    peer.start()
    wait_for(bridge._peer_is_there.is_set)
    bridge.put(event(50))
    wait_for(lambda: 50 in numbers(peer))
    assert not set(range(2, 50)) & set(numbers(peer))


@pytest.mark.parametrize("peer", CONNECTING, indirect=True)
def test_a_frozen_peer_later_gets_one_stale_event_at_most(
    peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("touchd.daemon.bridges.bridge.STALE_S", 0.3)
    peer.start()
    real, peer.port = peer.port, free_port()
    is_frozen = threading.Event()

    def freezing(client: socket.socket, goes_on: Callable[[], bool]) -> None:
        attackers.forward(client, real, goes_on, hold=is_frozen.is_set)

    with attackers.server(peer.port, freezing):
        bridge = peer.bridge()
        put_until_received(peer, bridge)
        is_frozen.set()
        for number in range(1, 20):
            bridge.put(event(number))
        time.sleep(0.4)
        is_frozen.clear()
        bridge.put(event(99))
        wait_for(lambda: 99 in numbers(peer))
        bridge.stop(STOP_S)
    assert numbers(peer) in ([1, 99], [99])


def say_nothing(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    while goes_on():
        time.sleep(0.01)


def take_nothing(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    attackers.welcome(client)
    say_nothing(client, goes_on)


def hang_up(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    attackers.welcome(client)


# No peer at all, and for those that connect, each kind of one that does not do what it should.
ILL = [
    *(pytest.param(*param.values, None, marks=param.marks) for param in ALL),
    *(
        pytest.param(*param.values, behaviour, marks=param.marks)
        for param in CONNECTING
        for behaviour in (say_nothing, take_nothing, hang_up)
    ),
]


@pytest.mark.parametrize(("peer", "behaviour"), ILL, indirect=["peer"])
def test_a_missing_or_ill_peer_delays_neither_put_nor_stop(
    peer: Peer, behaviour: attackers.Attack | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Bridge, "capacity", 5)
    with attackers.server(peer.port, behaviour) if behaviour else nullcontext([1]) as came:
        bridge = peer.bridge()
        wait_for(lambda: came[0] >= (4 if behaviour is hang_up else 1))
        slowest_s = 0.0
        for number in range(2000):
            began_s = time.monotonic()
            bridge.put(event(number))
            bridge.put_frame(frame(number), PAD)
            slowest_s = max(slowest_s, time.monotonic() - began_s)
        assert slowest_s < BUSY_S
        began_s = time.monotonic()
        bridge.stop(STOP_S)
        assert time.monotonic() - began_s < STOP_S + BUSY_S


@pytest.mark.parametrize("peer", CONNECTING, indirect=True)
def test_stopping_sends_queued_events(peer: Peer) -> None:
    peer.start()
    bridge = peer.bridge()
    put_until_received(peer, bridge)
    for number in range(100, 120):
        bridge.put(event(number))
    bridge.stop(WITHIN_S)
    wait_for(lambda: numbers(peer)[-20:] == list(range(100, 120)))


def test_a_server_that_takes_nothing_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("websockets")
    # While a send blocks, websockets can neither ping nor notice a missing answer.
    limit = (socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 300)
    monkeypatch.setattr(hosts, "OPTIONS", (*hosts.OPTIONS[:-1], limit))
    with closing(RosbridgePeer(tmp_path)) as peer, attackers.server(peer.port, take_nothing):
        bridge = peer.bridge()
        # Enough to fill the kernel's buffers for the peer before the first ping.
        times = itertools.count()

        def is_left() -> bool:
            for number in itertools.islice(times, 50):
                bridge.put_frame(frame(number, float(number)), PAD)
            return "is away" in caplog.text

        wait_for(is_left)
