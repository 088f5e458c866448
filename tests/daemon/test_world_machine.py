"""Random faults of pad, clock, line, robot, page, bridges, disk, log and signals; events stay correct."""

import ctypes
import gc
import os
import random
import resource
import socket
import tempfile
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from rigs import attackers
from rigs.audit import Audit
from rigs.live_rig import HANDSHAKE
from rigs.made_events import record
from rigs.made_pad import MadePad, nothing, palm, pat
from rigs.scripted_model import Scripted
from rigs.soak_line import CRASH
from rigs.sockets import free_port
from rigs.stub_robot import StubRobot
from rigs.wait import wait_for
from websockets.sync.client import connect

from touchd.daemon.app.config import LiveSettings, SensorSettings, Settings
from touchd.daemon.app.log import LogWriter
from touchd.daemon.bridges.bridge import Bridge
from touchd.daemon.bridges.mqtt import MqttBridge
from touchd.daemon.bridges.rosbridge import RosbridgeBridge
from touchd.daemon.bridges.settings import MqttSettings, RosbridgeSettings
from touchd.daemon.live.server import LiveServer
from touchd.daemon.path.events import Event, SensorEvent
from touchd.daemon.path.monitor import PadMonitor
from touchd.daemon.path.pipeline import Clock, Pipeline, PipelineSettings
from touchd.daemon.playback.rig import encoder_for
from touchd.daemon.robot.sink import RobotSink
from touchd.daemon.sinks.journal import Journal
from touchd.daemon.sinks.sink import EventFanout
from touchd.drivers.frame import SensorState
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.session import RobotSettings

PERIOD_MS = 1000 / 54
OLDEST_TOLD_MS = 2800
SECONDS = st.floats(0.1, 4.0)
MOST_VIEWERS = 4
# Memory for a thousand touches and the viewers, and for libraries that the first example loads.
MOST_GROWTH_MB = 60.0
memory_mb: list[float] = []


def resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def flood(port: int) -> socket.socket:
    """Open a viewer that sends far more than allowed and reads nothing."""
    viewer = socket.create_connection(("127.0.0.1", port), timeout=2)
    with suppress(OSError):
        viewer.sendall(HANDSHAKE.format(port=port).encode() + (b"\x89\xbc" + bytes(64)) * 1000)
    return viewer


def take_everything(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    """A rosbridge server that takes what comes."""
    attackers.welcome(client)
    while goes_on() and client.recv(65536):
        pass


def hang_up(client: socket.socket, _goes_on: Callable[[], bool]) -> None:
    client.recv(65536)


# How a broker and a rosbridge server may behave; None: it is gone.
PEERS: dict[str, list[attackers.Attack]] = {
    "broker": [
        attackers.acknowledge,
        attackers.unfinished_publishes,
        attackers.takes_nothing,
        attackers.zeros,
        hang_up,
    ],
    "rosbridge": [
        take_everything,
        attackers.empty_fragments,
        attackers.statuses,
        hang_up,
    ],
}


class Peer:
    """A server on one port that can change its behaviour."""

    def __init__(self) -> None:
        self.port = free_port()
        self._is_there = ExitStack()

    def become(self, attack: attackers.Attack | None) -> None:
        self._is_there.close()
        if attack is not None:
            self._is_there.enter_context(attackers.server(self.port, attack))


class World(RuleBasedStateMachine):
    """A state machine of everything that can happen to a daemon in a lab."""

    def __init__(self) -> None:
        super().__init__()
        self.closing = ExitStack()
        folder = Path(self.closing.enter_context(tempfile.TemporaryDirectory()))
        self.path = folder / "events.jsonl"
        self.now_s, self.sensor_ms, self.sent = 1000.0, 5000.0, 0
        self.pad = MadePad()
        self.audit = Audit(OLDEST_TOLD_MS)
        self.robot = StubRobot()
        self.robot.start()
        link = RobotLink(RobotSettings(url=self.robot.url), open_session=self.robot.open_session)
        # A log that nobody reads.
        self.ends = os.pipe()
        self.closing.enter_context(patch("touchd.daemon.app.log.LinesSink.capacity", 10))
        self.log = LogWriter(self.ends[1])
        listening = socket.create_server(("127.0.0.1", 0))
        self.page_port = listening.getsockname()[1]
        settings = Settings(robot=RobotSettings(url=self.robot.url))
        self.page = LiveServer(listening, LiveSettings(), {"pad": (settings, Scripted())})
        self.viewers: list[ExitStack] = []
        self.peers = {name: Peer() for name in PEERS}
        # What the broker retains, and the pad's state, which should be there.
        self.retained: dict[str, bytes] = {}
        self.state = "down"
        broker, rosbridge = (peer.port for peer in self.peers.values())
        self.bridges: tuple[Bridge, ...] = (
            MqttBridge(MqttSettings(host="127.0.0.1", port=broker, pressure_hz=10.0), "touchd", "pad"),
            RosbridgeBridge(
                RosbridgeSettings(url=f"ws://127.0.0.1:{rosbridge}", pressure_hz=10.0), "touchd", "pad"
            ),
        )
        self.fanout = EventFanout()
        journal = Journal(self.path, max_bytes=20_000, keep=1)
        self.fanout.sinks = (journal, self.page, *self.bridges, RobotSink(link))
        for sink in (*self.fanout.sinks, self.log):
            sink.start()
        clock = Clock(monotonic_s=lambda: self.now_s, epoch_s=lambda: 1795168800.0 + self.now_s)
        self.parser, self.encode = FrameParser(SensorSettings().described), encoder_for(SensorSettings())
        monitor = PadMonitor(parser=self.parser)
        self.pipeline = Pipeline(PipelineSettings(), Scripted(), self.emit, clock, monitor=monitor)

    def emit(self, event: Event) -> None:
        self.audit.see(event)
        if isinstance(event, SensorEvent):
            self.state = event.state
        assert getattr(event, "pad", "pad") == "pad"
        self.fanout.emit(event)
        self.log.handle(record("x" * 1000, line=self.sent))

    def feel(self, pressures: np.ndarray, held_up: bool = False) -> None:
        for counts in self.pad.counts(pressures):
            self.sent += 1
            self.sensor_ms += PERIOD_MS
            self.now_s += 0.0 if held_up else PERIOD_MS / 1000
            self.arrive(self.encode(counts, round(self.sensor_ms) % 2**32))

    def arrive(self, data: bytes) -> None:
        for frame in self.parser.feed(data, self.now_s):
            self.pipeline.on_frame(frame)
            self.page.put_frame(frame, 0)
            for bridge in self.bridges:
                bridge.put_frame(frame, "pad")

    @rule(seconds=SECONDS)
    def rest(self, seconds: float) -> None:
        self.feel(nothing(seconds))

    @rule(seconds=SECONDS, held_up=st.booleans())
    def touch(self, seconds: float, held_up: bool) -> None:
        self.now_s += seconds + 5.0 if held_up else 0.0
        self.feel(palm(seconds), held_up)

    @rule(seconds=SECONDS)
    def pat(self, seconds: float) -> None:
        self.feel(pat(seconds))

    @rule(jump_ms=st.sampled_from([-90_000, -900, -20, 100, 400, 90_000, 2**32 - 100]))
    def clock_jumps(self, jump_ms: int) -> None:
        self.sensor_ms = max(0.0, self.sensor_ms + jump_ms)

    @rule(tap_s=st.floats(0.02, 0.6), pause_s=st.floats(0.02, 2.0), times=st.integers(1, 8))
    def taps_at_any_rhythm(self, tap_s: float, pause_s: float, times: int) -> None:
        self.feel(np.concatenate([palm(tap_s), nothing(pause_s)] * times))

    @rule(is_told=st.booleans(), pause_s=st.floats(0.0, 1.9, allow_subnormal=False))
    def the_board_restarts(self, is_told: bool, pause_s: float) -> None:
        self.arrive(CRASH if is_told else b"")
        self.now_s += pause_s
        self.sensor_ms = 7.0

    @rule(share=st.floats(0.1, 0.9))
    def a_second_reader_takes_bytes(self, share: float) -> None:
        rng = random.Random(self.sent)
        for counts in self.pad.counts(palm(1.0)):
            self.sensor_ms += PERIOD_MS
            self.now_s += PERIOD_MS / 1000
            data = self.encode(counts, round(self.sensor_ms) % 2**32)
            cut = rng.randrange(len(data))
            self.arrive(data[:cut] if rng.random() < share else data)

    @rule()
    def unplug(self) -> None:
        self.pipeline.on_sensor_state(SensorState("down", "unplugged"))
        self.parser.reset()
        self.sensor_ms = 0.0
        self.pipeline.on_sensor_state(SensorState("up", "back"))

    @rule()
    def robot_goes(self) -> None:
        self.robot.kill()

    @rule()
    def robot_comes(self) -> None:
        self.robot.start()

    @rule(name=st.sampled_from(list(PEERS)), data=st.data())
    def peer_changes(self, name: str, data: st.DataObject) -> None:
        self.become(name, data.draw(st.sampled_from([None, *PEERS[name]])))

    def become(self, name: str, attack: attackers.Attack | None) -> None:
        if attack is attackers.acknowledge:
            attack = partial(attackers.acknowledge, retained=self.retained)
        self.peers[name].become(attack)

    @rule()
    def journal_is_deleted(self) -> None:
        self.path.unlink(missing_ok=True)

    @rule(is_full=st.booleans())
    def disk(self, is_full: bool) -> None:
        # With this limit a write fails as on a full disk.
        hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 if is_full else hard, hard))

    @rule(is_hostile=st.booleans())
    def viewer_comes(self, is_hostile: bool) -> None:
        if len(self.viewers) < MOST_VIEWERS:
            url = f"ws://127.0.0.1:{self.page_port}/stream"
            self.viewers.append(ExitStack())
            viewer = flood(self.page_port) if is_hostile else connect(url, close_timeout=0.1)
            self.viewers[-1].enter_context(viewer)

    @rule()
    def viewer_goes(self) -> None:
        if self.viewers:
            self.viewers.pop(0).close()

    @invariant()
    def events_are_true_and_in_order(self) -> None:
        assert not self.audit.wrong

    def teardown(self) -> None:
        self.disk(is_full=False)
        self.feel(nothing(15.0))
        try:
            assert not self.audit.is_open
        finally:
            for viewer in self.viewers:
                viewer.close()
            # In the end each bridge finds a server that behaves.
            for peer in self.peers.values():
                peer.become(None)
            self.retained.clear()
            for name in self.peers:
                self.become(name, PEERS[name][0])
            wait_for(lambda: all(bridge._peer_is_there.is_set() for bridge in self.bridges))
            wait_for(lambda: self.retained == {"touchd/pad/state": self.state.encode()})
            for sink in (*self.fanout.sinks, self.log):
                sink.stop(2.0)
            for peer in self.peers.values():
                peer.become(None)
            self.robot.kill()
            for fd in self.ends:
                os.close(fd)
            sizes = [file.stat().st_size for file in self.path.parent.glob("events*")]
            self.closing.close()
        assert max(sizes, default=0) <= 20_000
        # Worlds that have ended wait in cycles for the collector, and the C library keeps what they freed.
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        memory_mb.append(resident_mb())
        assert memory_mb[-1] < memory_mb[0] + MOST_GROWTH_MB


World.TestCase.settings = settings(max_examples=100, stateful_step_count=30, deadline=None)


@pytest.mark.slow
@pytest.mark.timeout(900)
class TestWorld(World.TestCase):  # type: ignore[name-defined,misc]
    """Events stay correct after any sequence of rules."""
