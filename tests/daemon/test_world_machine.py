"""Pad, clock, line, robot, journal, log and reloads, all at once in any order; the events stay in order."""

from __future__ import annotations

import itertools
import os
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from rigs.made_pad import MadePad, nothing, palm, pat
from rigs.scripted_model import Scripted

from daemon.decide import DecisionSettings
from daemon.events import Event, Prediction, SensorEvent, TouchBegan, TouchEnded
from daemon.kept.journal import Journal
from daemon.kept.touches import gather
from daemon.pipeline import Clock, Pipeline, PipelineSettings
from daemon.sinks import EventFanout, JournalSink, LogSink, RobotSink
from drivers.fakes.fake_robot import StubRobot
from drivers.frame import Frame
from drivers.pad.sensor_state import SensorState
from drivers.robot.link import RobotLink
from drivers.robot.settings import RobotSettings

PERIOD_MS = 1000 / 54
ORDER = {"early": 0, "revised": 1, "final": 2, "ongoing": 3, "released": 4, "uncertain": 4}
SECONDS = st.floats(0.1, 4.0)


class World(RuleBasedStateMachine):
    """What a lab can do to a daemon."""

    def __init__(self) -> None:
        super().__init__()
        self.closing = ExitStack()
        folder = Path(self.closing.enter_context(tempfile.TemporaryDirectory()))
        self.path = folder / "events.jsonl"
        self.now_s, self.sensor_ms, self.sent = 1000.0, 5000.0, 0
        self.pad = MadePad()
        self.events: list[Event] = []
        self.robot = StubRobot()
        self.robot.start()
        link = RobotLink(RobotSettings(url=self.robot.url), open_session=self.robot.open_session)
        # A log that nobody reads.
        self.ends = os.pipe()
        self.log = LogSink(self.ends[1], capacity=10)
        self.fanout = EventFanout()
        self.fanout.sinks = (
            JournalSink(Journal(self.path, max_bytes=20_000, keep=1)),
            RobotSink(link, itertools.count(1)),
        )
        for sink in (*self.fanout.sinks, self.log):
            sink.start()
        self.pipeline = self.make(None)

    def make(self, before: Pipeline | None, stale_s: float = 2.0) -> Pipeline:
        clock = Clock(monotonic_s=lambda: self.now_s, epoch_s=lambda: 1795168800.0 + self.now_s)
        chosen = PipelineSettings(decision=DecisionSettings(stale_s=stale_s))
        return Pipeline(chosen, Scripted(), self.emit, clock, before=before)

    def emit(self, event: Event) -> None:
        self.events.append(event)
        self.fanout.emit(event)
        self.log.put("x" * 1000)

    def feel(self, pressures: np.ndarray, held_up: bool = False) -> None:
        for counts in self.pad.counts(pressures):
            self.sent += 1
            self.sensor_ms += PERIOD_MS
            self.now_s += 0.0 if held_up else PERIOD_MS / 1000
            self.pipeline.on_frame(Frame(self.sent, round(self.sensor_ms) % 2**32, self.now_s, counts))

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

    @rule()
    def unplug(self) -> None:
        self.pipeline.on_sensor_state(SensorState("down", "unplugged"))
        self.sensor_ms = 0.0
        self.pipeline.on_sensor_state(SensorState("up", "back"))

    @rule(stale_s=st.sampled_from([0.5, 2.0]))
    def reload(self, stale_s: float) -> None:
        if not self.pipeline.has_touch:
            self.pipeline = self.make(self.pipeline, stale_s)

    @rule()
    def robot_goes(self) -> None:
        self.robot.kill()

    @rule()
    def robot_comes(self) -> None:
        self.robot.start()

    @rule()
    def journal_is_deleted(self) -> None:
        self.path.unlink(missing_ok=True)

    @invariant()
    def numbers_rise_and_one_touch_is_open_at_most(self) -> None:
        marks = [event for event in self.events if isinstance(event, TouchBegan | TouchEnded)]
        numbers = [number for number in range(1, len(marks) + 1) for _ in "be"][: len(marks)]
        assert [mark.touch for mark in marks] == numbers
        assert all(isinstance(mark, TouchEnded) == bool(i % 2) for i, mark in enumerate(marks))

    def teardown(self) -> None:
        self.feel(nothing(15.0))
        try:
            assert not self.pipeline.has_touch
            for felt in gather(self.events):
                assert felt.ended is not None
                check(felt.predictions)
            assert all(event.pad == "pad" for event in self.events if isinstance(event, SensorEvent))
        finally:
            for sink in (*self.fanout.sinks, self.log):
                sink.stop(2.0)
            self.robot.kill()
            for fd in self.ends:
                os.close(fd)
            self.closing.close()
        assert all(file.stat().st_size <= 20_000 for file in self.path.parent.glob("events*"))


def check(answers: Sequence[Prediction]) -> None:
    """One touch's answers: their order, what changed, and what was told."""
    stages = [ORDER[answer.stage] for answer in answers]
    assert stages == sorted(stages)
    before = None
    for answer in answers:
        if answer.stage != "uncertain":
            assert answer.changed == (answer.gesture != before)
        before = answer.gesture
        assert not answer.told or answer.age_ms <= 2800
    told = [answer.gesture for answer in answers if answer.told]
    assert all(one != two for one, two in itertools.pairwise(told))


World.TestCase.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)


@pytest.mark.slow
@pytest.mark.timeout(600)
class TestWorld(World.TestCase):  # type: ignore[name-defined,misc]
    """Whatever happens in whatever order, the events stay true."""
