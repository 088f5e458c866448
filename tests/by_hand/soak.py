"""A day of sensor time, flat out: nothing grows, nothing is lost. By hand: make soak, or

    MALLOC_MMAP_THRESHOLD_=131072 PYTHONPATH=.:tests python -m by_hand.soak --hours 24 --out soak.json

with the memory settings of the service.

Bytes go through parser, ring, touch tracker, classifier, decision, monitor, journal, kept touches, the link
to a stand-in robot that is switched off and on, the live page, with a viewer now and then, and MQTT, with a
broker that comes and goes (if mosquitto is installed). The pad is unplugged at times, its board restarts,
its line has bursts of garbage, and some touches are in passing. The pad is another program, its line a pipe,
which waits for the daemon's parts; a serial port does not wait, and frames would be dropped. Ends with exit
code 1 when anything grew or was lost.
"""

import argparse
import gc
import json
import os
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rigs.audit import Audit, Viewer
from rigs.peers import MOSQUITTO, broker, subscribed
from rigs.soak_line import pad
from rigs.sockets import free_port
from rigs.stub_robot import StubRobot

from touchd.daemon.app.config import LiveSettings, Settings
from touchd.daemon.app.parts import load_model, make_bridges
from touchd.daemon.bridges.settings import MqttSettings
from touchd.daemon.live.server import LiveServer
from touchd.daemon.path.events import Event, TouchEnded, encode
from touchd.daemon.path.pipeline import Pipeline
from touchd.daemon.robot.sink import RobotSink
from touchd.daemon.sinks.journal import Journal
from touchd.daemon.sinks.touch_store import (
    EndedTouch,
    SavedTouch,
    TouchSink,
    TouchStore,
    description_of,
    folder_of,
    saved_touches,
)
from touchd.drivers.frame import FRAME_RATE_HZ, SensorState
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.recording import read_recordings
from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.session import RobotSettings

HOUR_FRAMES = round(3600 * FRAME_RATE_HZ)
ROBOT_EVERY_FRAMES = HOUR_FRAMES // 8
UNPLUGGED_EVERY_FRAMES = HOUR_FRAMES // 3
MAX_GROWTH_MB = 5.0
JOURNAL_BYTES = 1_000_000
JOURNAL_KEEP = 2
TOUCHES_KEPT = 50
WRITTEN_S = 10.0
# The robot's switches divide an hour into eight spans; a viewer and the broker come in this one.
LOOKED_AT = 3
RECONNECTED_S = 30.0


def memory_mb() -> float:
    """This process's resident memory (see proc(5))."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class PromptStore(TouchStore):
    """Signals when a touch is written. The soak waits for it, as its touches come faster than real ones."""

    written = threading.Semaphore(0)

    def add(self, touch: EndedTouch) -> None:
        """Write a touch, and signal it."""
        super().add(touch)
        self.written.release()


class Broker:
    """An MQTT broker that comes and goes, and remembers nothing.

    times: how often it came. states: how often the pad's state was there soon afterwards.
    """

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.times = self.states = 0
        self._folder = folder
        self._there = ExitStack()

    def come(self) -> None:
        """Start, and wait until the daemon has published the pad's state."""
        if MOSQUITTO is None:
            return
        self.times += 1
        arrived = threading.Event()

        def hear(message: Any) -> None:
            if message.topic.endswith("/state") and message.payload in (b"up", b"down", b"degraded"):
                arrived.set()

        self._there.enter_context(broker(self._folder, self.port))
        self._there.enter_context(subscribed(self.port, "touchd/#", hear))
        self.states += arrived.wait(RECONNECTED_S)

    def leave(self) -> None:
        """End; may be repeated."""
        self._there.close()


class Soak:
    """The daemon's parts, joined as in the daemon, and hourly measurements."""

    def __init__(self, folder: Path) -> None:
        self.audit = Audit()
        self.robot = StubRobot()
        self.robot_switched = 0
        self.hours: list[dict[str, float]] = []
        self._path = folder / "events.jsonl"
        self._latest: deque[bytes] = deque(maxlen=1000)
        port = free_port()
        settings = Settings(live=LiveSettings(port=port))
        model = load_model(settings)
        self._parser = FrameParser(settings.sensor.described)
        self._journal = Journal(self._path, max_bytes=JOURNAL_BYTES, keep=JOURNAL_KEEP)
        self._link = RobotLink(RobotSettings(url=self.robot.url), open_session=self.robot.open_session)
        self._store = PromptStore(folder_of(self._path), TOUCHES_KEPT, description_of(settings.sensor))
        self._touch_sink = TouchSink({"pad": self._store})
        self._live_sink = LiveServer(settings, {"pad": model})
        robot_sink = RobotSink(self._link)
        self.broker = Broker(folder)
        mqtt = MqttSettings(host="127.0.0.1", port=self.broker.port, discovery=None)
        self._bridges = make_bridges(Settings(mqtt=mqtt), {"pad": model})
        self._sinks = (
            self._journal,
            robot_sink,
            self._touch_sink,
            self._live_sink,
            *self._bridges,
        )
        for sink in self._sinks:
            sink.start()
        self.viewer = Viewer(port)
        self._pipeline = Pipeline(settings.pipeline, model, self._emit)

    def run(self, line: Iterable[bytes], hours: float) -> dict[str, object]:
        """Read `hours` of sensor time from a pad; return the figures."""
        frames = 0
        self._measure()
        for data in line:
            before = frames
            for frame in self._parser.feed(data, time.monotonic()):
                self._touch_sink.put_frame(frame)
                self._pipeline.on_frame(frame)
                self._live_sink.put_frame(frame, 0)
                frames += 1
            if frames // ROBOT_EVERY_FRAMES != before // ROBOT_EVERY_FRAMES:
                self._switch_the_robot()
            if frames // UNPLUGGED_EVERY_FRAMES != before // UNPLUGGED_EVERY_FRAMES:
                self._unplug()
            if frames // HOUR_FRAMES != before // HOUR_FRAMES:
                self._measure()
            if frames >= hours * HOUR_FRAMES:
                break
        self._pipeline.flush()
        self.viewer.leave()
        self.broker.leave()
        for sink in self._sinks:
            sink.stop(10.0)
        return self._figures(frames)

    def _emit(self, event: Event) -> None:
        self.audit.see(event)
        self._latest.append(encode(event))
        for sink in self._sinks:
            sink.put(event)
        if isinstance(event, TouchEnded):
            self._store.written.acquire(timeout=WRITTEN_S)

    def _switch_the_robot(self) -> None:
        self.robot_switched += 1
        if self.robot_switched % 2:
            self.robot.start()
        else:
            self.robot.kill()
        if self.robot_switched % 8 == LOOKED_AT:
            self.viewer.come()
            self.broker.come()
        else:
            self.viewer.leave()
            self.broker.leave()

    def _unplug(self) -> None:
        self._pipeline.on_sensor_state(SensorState("down", "unplugged"))
        self._parser.reset()
        self._pipeline.on_sensor_state(SensorState("up", "plugged in"))

    def _measure(self) -> None:
        # A closed MQTT client is a cycle, and keeps two sockets until it is collected.
        gc.collect()
        self.hours.append(
            {
                "memory_mb": round(memory_mb(), 2),
                "threads": len(os.listdir("/proc/self/task")),
                "descriptors": len(os.listdir("/proc/self/fd")),
            }
        )

    def _figures(self, frames: int) -> dict[str, object]:
        settled = self.hours[1:] or self.hours
        growth_mb = max(hour["memory_mb"] for hour in settled) - settled[0]["memory_mb"]
        kept = saved_touches(folder_of(self._path))
        return {
            "malloc_mmap_threshold": os.environ.get("MALLOC_MMAP_THRESHOLD_", "glibc's own"),
            "sensor_hours": round(frames / HOUR_FRAMES, 3),
            "frames": frames,
            "frames_refused": self._parser.counts.bad,
            "restarts_of_the_board": self._parser.counts.restarts,
            "touches": self.audit.touches,
            "memory_growth_after_first_hour_mb": round(growth_mb, 2) if len(self.hours) > 2 else None,
            "hours": self.hours,
            "messages_seen_on_the_page": self.viewer.seen,
            "times_the_broker_came": self.broker.times,
            "wrong": list(self.audit.wrong),
            "holds": self._holds(settled, growth_mb, kept),
        }

    def _holds(
        self, settled: Sequence[dict[str, float]], growth_mb: float, kept: Sequence[SavedTouch]
    ) -> dict[str, bool]:
        """Return which promises hold. settled: the hours after the first."""
        files = [self._path.with_name(f"{self._path.name}.{number}") for number in range(JOURNAL_KEEP, 0, -1)]
        written = b"".join(file.read_bytes() for file in [*files, self._path] if file.exists())
        latest = list(self._latest)
        return {
            "every touch has its answers, none twice": not self.audit.wrong and self.audit.touches > 0,
            "memory grows at most 5 MB after the first hour": growth_mb <= MAX_GROWTH_MB,
            "threads and descriptors are constant": all(
                hour["threads"] == settled[0]["threads"] and hour["descriptors"] == settled[0]["descriptors"]
                for hour in settled
            ),
            "the journal holds the latest events and stays within its bound": (
                [entry.rstrip() for entry in written.splitlines()[-len(latest) :]] == latest
                and len(written) <= JOURNAL_BYTES * (JOURNAL_KEEP + 1)
                and self._journal.lost + self._journal.dropped == 0
            ),
            "the last touches are kept, no more than asked for, and can be read": (
                len(kept) == min(TOUCHES_KEPT, self.audit.touches)
                and self._store.lost + self._touch_sink.dropped == 0
                and all(read_recordings(touch.path) for touch in kept)
            ),
            "the pad's state is there whenever a broker comes": self.broker.states == self.broker.times,
        }


def main() -> int:
    """Soak, and write the figures; returns 1 when anything grew or was lost."""
    parser = argparse.ArgumentParser(description="A day of sensor time, flat out: nothing grows or is lost.")
    parser.add_argument("--hours", type=float, default=24.0, help="of sensor time (default 24)")
    parser.add_argument("--out", type=Path, help="write the figures there too, as JSON")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="touchd-soak-") as folder, pad() as line:
        figures = Soak(Path(folder)).run(line, options.hours)
    text = json.dumps(figures, indent=1) + "\n"
    sys.stdout.write(text)
    if options.out:
        options.out.write_text(text)
    holds = figures["holds"]
    assert isinstance(holds, dict)
    return 0 if all(holds.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
