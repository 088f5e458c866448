"""Random faults of pad, clock, line, robot and journal; events stay correct and in order."""

import random
import tempfile
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from rigs.audit import Audit
from rigs.made_pad import MadePad, nothing, palm, pat
from rigs.scripted_model import Scripted
from rigs.stub_robot import StubRobot

from touchd.daemon.app.config import SensorSettings
from touchd.daemon.path.events import Event
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


class World(RuleBasedStateMachine):
    """A state machine of what can happen to a pad, its line and the robot in a lab."""

    def __init__(self) -> None:
        super().__init__()
        self.closing = ExitStack()
        self.path = Path(self.closing.enter_context(tempfile.TemporaryDirectory())) / "events.jsonl"
        self.now_s, self.sensor_ms, self.sent = 1000.0, 5000.0, 0
        self.pad, self.audit = MadePad(), Audit(OLDEST_TOLD_MS)
        self.robot = StubRobot()
        self.robot.start()
        link = RobotLink(RobotSettings(url=self.robot.url), open_session=self.robot.open_session)
        self.fanout = EventFanout()
        self.fanout.sinks = (Journal(self.path), RobotSink(link))
        for sink in self.fanout.sinks:
            sink.start()
        clock = Clock(monotonic_s=lambda: self.now_s, epoch_s=lambda: 1795168800.0 + self.now_s)
        self.parser, self.encode = FrameParser(SensorSettings().described), encoder_for(SensorSettings())
        monitor = PadMonitor(parser=self.parser)
        self.pipeline = Pipeline(PipelineSettings(), Scripted(), self.emit, clock, monitor=monitor)

    def emit(self, event: Event) -> None:
        self.audit.see(event)
        self.fanout.emit(event)

    def feel(self, pressures: np.ndarray, held_up: bool = False) -> None:
        for counts in self.pad.counts(pressures):
            self.sent += 1
            self.sensor_ms += PERIOD_MS
            self.now_s += 0.0 if held_up else PERIOD_MS / 1000
            self.arrive(self.encode(counts, round(self.sensor_ms) % 2**32))

    def arrive(self, data: bytes) -> None:
        for frame in self.parser.feed(data, self.now_s):
            self.pipeline.on_frame(frame)

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

    @rule(pause_s=st.floats(0.0, 1.9, allow_subnormal=False))
    def the_board_restarts(self, pause_s: float) -> None:
        self.now_s += pause_s
        self.sensor_ms = 7.0

    @rule(share=st.floats(0.1, 0.9))
    def a_second_reader_takes_bytes(self, share: float) -> None:
        rng = random.Random(self.sent)
        for counts in self.pad.counts(palm(1.0)):
            self.sensor_ms += PERIOD_MS
            self.now_s += PERIOD_MS / 1000
            data = self.encode(counts, round(self.sensor_ms) % 2**32)
            self.arrive(data[: rng.randrange(len(data))] if rng.random() < share else data)

    @rule()
    def unplug(self) -> None:
        self.pipeline.on_sensor_state(SensorState("down", "unplugged"))
        self.parser.reset()
        self.sensor_ms = 0.0
        self.pipeline.on_sensor_state(SensorState("up", "back"))

    @rule(is_there=st.booleans())
    def robot_comes_or_goes(self, is_there: bool) -> None:
        (self.robot.start if is_there else self.robot.kill)()

    @rule()
    def journal_is_deleted(self) -> None:
        self.path.unlink(missing_ok=True)

    @invariant()
    def events_are_true_and_in_order(self) -> None:
        assert not self.audit.wrong

    def teardown(self) -> None:
        self.feel(nothing(15.0))
        for sink in self.fanout.sinks:
            sink.stop(2.0)
        self.robot.kill()
        self.closing.close()
        assert not self.audit.is_open


World.TestCase.settings = settings(max_examples=100, stateful_step_count=30, deadline=None)


@pytest.mark.slow
@pytest.mark.timeout(900)
class TestWorld(World.TestCase):  # type: ignore[name-defined,misc]
    """Events stay correct after any sequence of rules."""
