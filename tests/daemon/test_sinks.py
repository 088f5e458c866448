"""Sinks never block the loop and stop when asked; the journal holds whole lines within its limit."""

import json
import os
import random
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest
from rigs.made_events import PREDICTION, touch
from rigs.programs import Program, ran
from rigs.small_disk import log_on_small_disk, needs_small_disk
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.app.config import JournalSettings, Settings
from touchd.daemon.path.events import Event, RobotAction, SensorEvent, encode
from touchd.daemon.path.service import Service
from touchd.daemon.robot.sink import RobotSink
from touchd.daemon.sinks.journal import Journal, JournalError
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


def kept(path: Path) -> list[Event]:
    return [decode(line) for line in path.read_bytes().splitlines()]


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


def test_what_a_robot_does_comes_after_its_cause(pipe: tuple[int, int]) -> None:
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


def test_the_robot_stops_first_so_its_last_acts_are_told(
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
    service.tell(LinesSink("stdout", 1, encode))
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


def test_stopping_writes_what_is_queued_and_may_be_repeated(tmp_path: Path) -> None:
    sink = Journal(tmp_path / "events.jsonl")
    sink.start()
    for number in range(200):
        sink.put(touch(number))
    sink.stop(WITHIN_S)
    sink.stop(WITHIN_S)
    assert kept(tmp_path / "events.jsonl") == [touch(number) for number in range(200)]
    assert "touchd-journal" not in names()


def numbered(count: int) -> list[bytes]:
    return [b'{"type":"n","n": %d}' % number for number in range(count)]


def write(path: Path, lines: list[bytes], **limits: int) -> None:
    """Append lines to a journal; keeps one older file unless told otherwise."""
    journal = Journal(path, **({"max_bytes": 100, "keep": 1} | limits))
    for line in lines:
        journal.append(line)
    journal.close()


def test_the_journal_rotates_within_its_limits(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    write(path, numbered(200), max_bytes=1000, keep=2)
    files = [*(tmp_path / f"events.jsonl.{number}" for number in (2, 1)), path]
    assert sorted(tmp_path.iterdir()) == sorted(files)
    assert all(file.stat().st_size <= 1000 for file in files)
    lines = [line for file in files for line in file.read_bytes().splitlines()]
    assert lines == numbered(200)[-len(lines) :] != []


def test_a_journal_behind_a_link_rotates_where_it_lies(tmp_path: Path) -> None:
    (disk := tmp_path / "disk").mkdir()
    (link := tmp_path / "events.jsonl").symlink_to(disk / "touches.jsonl")
    write(link, numbered(20))
    assert link.is_symlink()
    assert sorted(file.name for file in disk.iterdir()) == ["touches.jsonl", "touches.jsonl.1"]


def test_half_a_line_left_by_a_power_cut_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    path.write_bytes(b'{"type":"n","n": 0}\n{"type":"n","n": ')
    write(path, numbered(2)[1:])
    assert path.read_bytes().splitlines() == numbered(2)


def test_an_unusable_journal_is_reported_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match=r"cannot be written \(No such file or directory\)"):
        Journal(tmp_path / "nowhere" / "events.jsonl", max_bytes=1000, keep=1)
    loop = tmp_path / "loop.jsonl"
    loop.symlink_to(loop)
    with pytest.raises(JournalError, match=r"loop.jsonl: cannot be written \(Too many levels of symbolic"):
        Journal(loop, max_bytes=1000, keep=1)


FILL_THE_DISK = """
import json, logging, resource, signal, sys
from pathlib import Path
from touchd.daemon.sinks.journal import Journal
logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
path = Path(sys.argv[1]) / "events.jsonl"
ballast = path.with_name("ballast")
ballast.write_bytes(bytes(16_384))
journal = Journal(path, max_bytes=10**9, keep=1)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, resource.RLIM_INFINITY))
number = 0
while journal.lost < 500:
    journal.append(b'{"type":"n","n": %d}' % number)
    number += 1
full = [json.loads(line)["n"] for line in path.read_bytes().splitlines()]
ballast.unlink()
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
journal.append(b'{"type":"n","n": -1}')
after = [json.loads(line)["n"] for line in path.read_bytes().splitlines()]
assert full == list(range(number - 500)), full[-5:]
assert after == [*full, -1], after[-5:]
"""


def check_told(log: list[str]) -> None:
    warning, recovery = log
    assert warning.startswith("WARNING")
    assert "No space left on device; events cannot be saved" in warning
    assert recovery.startswith("INFO")
    assert "works again; 500 events were lost" in recovery


def test_a_full_disk_leaves_only_whole_lines(tmp_path: Path) -> None:
    # A limit on file size simulates a full disk.
    done = ran([sys.executable, "-c", FILL_THE_DISK, str(tmp_path)])
    assert done.returncode == 0, done.stderr
    check_told(done.stderr.splitlines())


@needs_small_disk
def test_a_journal_survives_a_really_full_disk(tmp_path: Path) -> None:
    check_told(log_on_small_disk(tmp_path, 64, FILL_THE_DISK))


KILL_MID_WRITE = """
import random, sys
from pathlib import Path
from touchd.daemon.sinks.journal import Journal
journal = Journal(Path(sys.argv[1]), max_bytes=100_000, keep=3)
print("writing", flush=True)
while True:
    journal.append(b'{"type":"n","n": "' + b"x" * random.randrange(1, 1000) + b'"}')
"""


@pytest.mark.parametrize("times", [1, pytest.param(50, marks=pytest.mark.slow)])
def test_a_kill_at_any_point_leaves_a_whole_journal(tmp_path: Path, times: int) -> None:
    path, chance = tmp_path / "events.jsonl", random.Random(1)
    for attempt in range(times):
        with Program(sys.executable, "-c", KILL_MID_WRITE, path) as process:
            process.stdout.readline()
            while attempt == 0 and not path.with_name("events.jsonl.1").exists():
                assert process.poll() is None
            time.sleep(chance.uniform(0.0, 0.1))
            process.kill()
        # Opening the journal cuts off a half-written line.
        Journal(path, max_bytes=100_000, keep=3).close()
        for file in tmp_path.iterdir():
            written = file.read_bytes()
            assert written.endswith(b"\n") or not written
            assert all(json.loads(line)["n"] for line in written.splitlines())
    assert sum(file.stat().st_size for file in tmp_path.iterdir()) <= 4 * 100_000
