"""Real peers of the bridges, which a test can stop and restart."""

import json
import os
import shutil
import socket
import subprocess
import tempfile
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigs.sockets import free_port
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.bridges.bridge import Bridge
from touchd.daemon.bridges.process import ProcessBridge
from touchd.daemon.bridges.settings import LslSettings, MqttSettings, Ros2Settings, RosbridgeSettings
from touchd.drivers.frame import Frame

PAD = "pad"
MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
DDS_ON_LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><Peers><Peer Address='127.0.0.1'/></Peers>"
    "<ParticipantIndex>auto</ParticipantIndex></Discovery></Domain></CycloneDDS>"
)
LSL_ON_LOOPBACK = "[ports]\nIPv6 = disable\n[multicast]\nResolveScope = machine\n[log]\nlevel = -3\n"
# Read when the library is loaded.
_lsl_file = Path(tempfile.gettempdir()) / "touchd-tests-lsl.cfg"
_lsl_file.write_text(LSL_ON_LOOPBACK)
os.environ["LSLAPICFG"] = str(_lsl_file)
os.environ["CYCLONEDDS_URI"] = DDS_ON_LOOPBACK


def frame(number: int, host_s: float | None = None) -> Frame:
    counts = np.random.default_rng(number).integers(0, 1024, (8, 8)).astype(np.uint16)
    return Frame(number * 19, time.monotonic() if host_s is None else host_s, counts)


class Peer(ABC):
    """A subscriber; `received` is kept across restarts."""

    port: int

    def __init__(self) -> None:
        self.received: list[str] = []
        self._bridges, self._is_there = ExitStack(), ExitStack()

    @abstractmethod
    def make(self) -> Bridge: ...

    @abstractmethod
    def listening(self) -> AbstractContextManager[object]:
        """Run the peer, subscribed."""

    def bridge(self) -> Bridge:
        """Return a started bridge to this peer, which tries ten times a second while it is away."""
        bridge = self.make()
        bridge.retry_s = 0.1
        self._bridges.callback(bridge.stop, 2.0)
        bridge.start()
        return bridge

    def start(self) -> None:
        """Start, and subscribe."""
        self._is_there.enter_context(self.listening())

    def stop(self) -> None:
        """Stop; may be repeated."""
        self._is_there.close()

    def close(self) -> None:
        """Stop the bridges and the peer."""
        self._bridges.close()
        self.stop()


@contextmanager
def in_thread(listen: Callable[[threading.Event], None]) -> Iterator[None]:
    """Listen in a thread, until the event that it is given is set."""
    ending = threading.Event()
    thread = threading.Thread(target=listen, args=(ending,))
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


@contextmanager
def broker(folder: Path, port: int, lines: str = "allow_anonymous true\n") -> Iterator[None]:
    """Run a mosquitto on this port."""
    assert MOSQUITTO is not None
    file = folder / f"mosquitto-{port}.conf"
    file.write_text(f"listener {port} 127.0.0.1\n{lines}")
    with subprocess.Popen([MOSQUITTO, "-c", str(file)], stderr=subprocess.DEVNULL) as process:
        try:
            wait_for(lambda: _listens(port))
            yield
        finally:
            # On SIGTERM it saves its sessions; one that has hardly begun misses the signal.
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(5.0)
            process.kill()


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@contextmanager
def subscribed(
    port: int, topic: str, hear: Callable[[Any], None] | None = None, session: str = "", **options: Any
) -> Iterator[list[Any]]:
    """Subscribe to a topic; yields the list of messages, unless `hear` gets them.

    session: a name under which the broker remembers the subscription while the client is away.
    """
    import paho.mqtt.client as mqtt
    from paho.mqtt.enums import CallbackAPIVersion

    messages: list[Any] = []
    there = threading.Event()
    client = mqtt.Client(CallbackAPIVersion.VERSION2, session, clean_session=not session)
    if "user" in options:
        client.username_pw_set(options["user"], options["password"])
    if "ca_file" in options:
        client.tls_set(options["ca_file"])
    client.on_connect = lambda *_: client.subscribe(topic, qos=1)
    client.on_subscribe = lambda *_: there.set()
    client.on_message = lambda _client, _data, message: (hear or messages.append)(message)
    client.connect("localhost" if "ca_file" in options else "127.0.0.1", port)
    client.loop_start()
    try:
        assert there.wait(WITHIN_S), "the broker has not answered"
        yield messages
    finally:
        client.disconnect()
        client.loop_stop()


class MqttPeer(Peer):
    """A mosquitto and a subscribed client.

    The broker keeps the subscription and queues messages while the client is away.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.port = free_port()
        self._folder = folder
        self.start()
        self.stop()

    def make(self) -> Bridge:
        from touchd.daemon.bridges.mqtt import MqttBridge

        return MqttBridge(MqttSettings(host="127.0.0.1", port=self.port), "touchd", PAD)

    @contextmanager
    def listening(self) -> Iterator[None]:
        lines = f"allow_anonymous true\npersistence true\npersistence_location {self._folder}/\nuser root\n"
        with (
            broker(self._folder, self.port, lines),
            subscribed(self.port, f"touchd/{PAD}/event", self._hear, session="peer"),
        ):
            yield

    def _hear(self, message: Any) -> None:
        self.received.append(message.payload.decode())


class RosbridgePeer(Peer):
    """A websocket server that takes rosbridge's operations."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.port = free_port()
        self.operations: list[dict[str, Any]] = []

    def make(self) -> Bridge:
        from touchd.daemon.bridges.rosbridge import RosbridgeBridge

        settings = RosbridgeSettings(url=f"ws://127.0.0.1:{self.port}", pressure_hz=54.0)
        return RosbridgeBridge(settings, "touchd", PAD)

    @contextmanager
    def listening(self) -> Iterator[None]:
        from websockets.sync.server import serve

        self._connections: list[Any] = []
        with serve(self._listen, "127.0.0.1", self.port) as server:
            thread = threading.Thread(target=server.serve_forever)
            thread.start()
            yield
            server.shutdown()
            for connection in self._connections:
                with suppress(OSError):
                    connection.socket.shutdown(socket.SHUT_RDWR)
            thread.join()

    def _listen(self, connection: Any) -> None:
        self._connections.append(connection)
        for text in connection:
            operation = json.loads(text)
            self.operations.append(operation)
            if operation["op"] == "publish" and operation["topic"].endswith("/event"):
                self.received.append(operation["msg"]["data"])


class LslPeer(Peer):
    """An inlet on the stream of markers."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.name = f"test{free_port()}"

    def make(self) -> Bridge:
        return ProcessBridge(LslSettings(), self.name, [PAD])

    def listening(self) -> AbstractContextManager[None]:
        return in_thread(self._listen)

    def _listen(self, ending: threading.Event) -> None:
        inlet = inlet_of(f"{self.name}-{PAD}-markers", ending)
        while not ending.is_set():
            sample, _ = inlet.pull_sample(timeout=0.05)
            if sample is not None:
                self.received.append(sample[0])


def inlet_of(name: str, ending: threading.Event) -> Any:
    """An open inlet on the stream of that name, once there is one."""
    import pylsl

    while not ending.is_set():
        for info in pylsl.resolve_byprop("name", name, timeout=1.0):
            inlet = pylsl.StreamInlet(info, recover=False)
            inlet.open_stream(timeout=WITHIN_S)
            return inlet
    raise AssertionError(f"no stream {name}")


class Ros2Peer(Peer):
    """A second participant in the domain, with a reader as rclpy makes it."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        # A separate domain for each test, unlike a lab's.
        self.domain = 100 + free_port() % 100

    def make(self) -> Bridge:
        return ProcessBridge(Ros2Settings(domain=self.domain), "touchd", [PAD])

    @contextmanager
    def listening(self) -> Iterator[None]:
        from cyclonedds.domain import DomainParticipant

        from touchd.daemon.bridges.ros2 import String

        reader = reader_of(DomainParticipant(self.domain), f"rt/touchd/{PAD}/event", String)

        def listen(ending: threading.Event) -> None:
            while not ending.is_set():
                self.received += [sample.data for sample in reader.take(100) if hasattr(sample, "data")]
                time.sleep(0.01)

        with in_thread(listen):
            yield


def reader_of(participant: Any, topic: str, kind: Any) -> Any:
    """Return a reliable, volatile reader of the last ten samples, ROS 2's default."""
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
    return DataReader(participant, Topic(participant, topic, kind), qos)
