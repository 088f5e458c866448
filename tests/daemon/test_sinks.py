"""Sinks never block the loop and stop when asked; the journal holds whole lines within its limit."""

import os
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest
from rigs.made_events import PREDICTION, touch
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.app.config import JournalSettings, Settings
from touchd.daemon.path.events import Event, RobotAction, SensorEvent, encode
from touchd.daemon.path.service import Service
from touchd.daemon.robot.sink import RobotSink
from touchd.daemon.sinks.journal import Journal
from touchd.daemon.sinks.sink import EventFanout, LinesSink, QueuedSink
from touchd.daemon.sinks.touches import decode
from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.session import RobotSettings


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    reader, writer = os.pipe()
    yield reader, writer
    for fd in (reader, writer):
        with suppress(OSError):
            os.close(fd)


class ShortSink(LinesSink[Event]):
    """Keeps ten events."""

    capacity = 10


def names() -> set[str]:
    return {thread.name for thread in threading.enumerate()}


def read(reader: int, count: int) -> list[Event]:
    """Return the next events in a pipe."""
    with open(reader, "rb", closefd=False) as file:
        return [decode(file.readline()) for _ in range(count)]


def test_events_come_out_as_json_lines_in_order(pipe: tuple[int, int]) -> None:
    reader, writer = pipe
    sink = LinesSink("stdout", writer, encode)
    sink.start()
    for number in range(50):
        sink.put(touch(number))
    sink.stop(WITHIN_S)
    assert read(reader, 50) == [touch(number) for number in range(50)]


@pytest.mark.parametrize(
    "long",
    [
        SensorEvent(state="down", time="", reason="x" * 60_000),
        msgspec.structs.replace(PREDICTION, model="x" * 60_000),
    ],
    ids=["states", "answers"],
)
def test_a_stalled_reader_blocks_nobody_and_its_losses_are_logged(
    pipe: tuple[int, int], caplog: pytest.LogCaptureFixture, long: Event
) -> None:
    sink = ShortSink("stdout", pipe[1], encode)
    sink.start()
    for _ in range(50):
        sink.put(long)
    assert 30 <= sink.dropped <= 40
    sink.stop(0.6)
    assert "touchd-stdout" not in names()
    told = [int(count) for count in re.findall(r"stdout: (\d+) events", caplog.text)]
    # Some events were written, and half of one is in the pipe.
    assert sink.dropped in told
    assert 45 <= sum(told) <= 50


def test_continuing_losses_are_logged_at_their_beginning_and_in_all(caplog: pytest.LogCaptureFixture) -> None:
    class SlowSink(QueuedSink[int]):
        capacity = 2
        written = 0

        def write(self, item: int) -> None:
            # While one event is written, more arrive than the queue holds.
            for number in range(5 if self.written < 10 else 0):
                self.put(number)
            self.written += 1

    sink = SlowSink("slow")
    sink.start()
    sink.put(0)
    wait_for(lambda: sink.written >= 12)
    sink.stop(WITHIN_S)
    # The sink may notice the end of the losses before it is stopped.
    assert [message for message in caplog.messages if "any more" not in message] == [
        "slow: events or frames are being lost: it is away, too slow, or its disk is full",
        f"slow: {sink.dropped} events or frames were lost in all",
    ]


def test_a_reaction_of_the_robot_follows_its_answer(pipe: tuple[int, int]) -> None:
    reader, writer = pipe
    fanout = EventFanout()
    done = RobotAction(touch=7, action="say", what="Hello", time=PREDICTION.time)

    class Link(RobotLink):
        """Acts before it returns, as a separate thread may."""

        def __init__(self) -> None:
            pass

        def put(self, name: str, detail: Sequence[object]) -> None:
            fanout.emit(done)

    lines = LinesSink("stdout", writer, encode)
    fanout.sinks = (lines, RobotSink(Link()))
    fanout.emit(PREDICTION)
    lines.start()
    lines.stop(WITHIN_S)
    lines.stop(WITHIN_S)
    assert read(reader, 2) == [PREDICTION, done]


def test_the_robot_stops_first_so_its_last_acts_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped: list[str] = []

    def noted(stop: Callable[..., None]) -> Callable[..., None]:
        return lambda sink, timeout_s: (stopped.append(type(sink).__name__), stop(sink, timeout_s))[1]

    for kind in (RobotSink, Journal, LinesSink):
        monkeypatch.setattr(kind, "stop", noted(kind.stop))
    settings = Settings(
        robot=RobotSettings(url="tcp://127.0.0.1:1"), journal=JournalSettings(path=str(tmp_path / "events"))
    )
    service = Service(settings)
    service.add_sink(LinesSink("stdout", 1, encode))
    service.run(lambda: True)
    assert stopped[0] == "RobotSink"
    assert sorted(stopped[1:]) == ["Journal", "LinesSink"]


def test_states_outlast_events_in_a_full_queue(pipe: tuple[int, int]) -> None:
    reader, writer = pipe
    sink = ShortSink("stdout", writer, encode)
    up = SensorEvent(state="up", time=PREDICTION.time)
    for event in (up, *map(touch, range(50))):
        sink.put(event)
    sink.start()
    sink.stop(WITHIN_S)
    assert read(reader, 1) == [up]


def test_a_broken_pipe_is_reported_once_and_ends_the_sink(pipe: tuple[int, int]) -> None:
    reader, writer = pipe
    os.close(reader)
    gone = threading.Semaphore(0)
    sink = LinesSink("stdout", writer, encode, gone.release)
    sink.start()
    sink.put(touch(1))
    assert gone.acquire(timeout=5)
    sink.put(touch(2))
    sink.stop(1.0)
    assert not gone.acquire(blocking=False)
    assert "touchd-stdout" not in names()


def test_a_full_disk_at_standard_output_loses_lines_only(caplog: pytest.LogCaptureFixture) -> None:
    gone: list[bool] = []
    full = os.open("/dev/full", os.O_WRONLY)
    sink = LinesSink("stdout", full, encode, lambda: gone.append(True))
    sink.start()
    for number in range(20):
        sink.put(touch(number))
    sink.stop(WITHIN_S)
    os.close(full)
    assert (sink.dropped, gone) == (20, [])
    said = [record.getMessage() for record in caplog.records]
    assert said[0].endswith("or its disk is full")
    assert said[1:] == ["stdout: 20 events or frames were lost in all"]
