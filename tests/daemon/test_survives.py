"""External faults: the daemon keeps running, reports them, and destroys nothing."""

import os
import shutil
import socket
import stat
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rigs.ended_touch import ended_touch
from rigs.expectations import LENGTHS, stream_of
from rigs.live_rig import HANDSHAKE, Served, frames_among
from rigs.made_events import PREDICTION, record, touch
from rigs.made_pad import MadePad, Scans, nothing, palm
from rigs.scripted_model import Scripted
from rigs.terminal import Terminal
from rigs.wait import AT_ONCE_S, WITHIN_S

from touchd.daemon.app import cli
from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.app.log import LogWriter
from touchd.daemon.path.events import Event, Label, Prediction, TouchEnded, encode
from touchd.daemon.path.pipeline import Clock, Pipeline, PipelineSettings
from touchd.daemon.path.staleness import Staleness
from touchd.daemon.playback.rig import SpawnedDaemon, encoder_for
from touchd.daemon.sinks.journal import Journal, JournalError
from touchd.daemon.sinks.sink import LinesSink
from touchd.daemon.sinks.touch_store import TouchStore, kept_touches
from touchd.daemon.sinks.touches import gather, read_events, read_labels
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Frame
from touchd.drivers.pad.grid import GridFrame
from touchd.drivers.recording import Recording, RecordingError, read_recordings, write_recordings
from touchd.drivers.whole_file import PARTIAL

PING = b"\x89\xbc" + bytes(4) + bytes(60)
EMPTY_TEXT = b"\x01\x80" + bytes(4)
EMPTY_CONTINUATION = b"\x00\x80" + bytes(4)


@pytest.mark.parametrize("said", [PING, EMPTY_CONTINUATION], ids=["pings", "empty fragments"])
def test_a_flooding_viewer_is_disconnected(served: Served, said: bytes) -> None:
    with (
        served.look() as viewer,
        socket.create_connection(("127.0.0.1", served.port), WITHIN_S) as flood,
    ):
        viewer.recv(timeout=WITHIN_S)
        flood.sendall(HANDSHAKE.format(port=served.port).encode() + EMPTY_TEXT * (said != PING))
        sent = 0
        with suppress(ConnectionError):
            while sent < 10_000_000:
                sent += flood.send(said * 100)
        # At most what the kernel's buffers hold on both sides.
        assert sent < 8_000_000
        frames_among(viewer, served.put_frame())


def full_pipe() -> tuple[int, int]:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with suppress(BlockingIOError):
        while True:
            os.write(writer, b"x" * 65536)
    os.set_blocking(writer, True)
    return reader, writer


def test_a_view_ends_well_when_its_terminal_is_closed() -> None:
    stream = stream_of(LENGTHS)
    with (
        FakePort(stream, encoder_for(SensorSettings()), loop=True) as port,
        Terminal("run", "--view", "--port", port.path) as terminal,
    ):
        terminal.until(port.path)
        terminal.close()
        terminal.process.terminate()
        assert terminal.process.wait(WITHIN_S) == 0


def test_a_log_that_nobody_reads_stops_nothing(tmp_path: Path) -> None:
    reader, writer = full_pipe()
    with FakePort(stream_of(LENGTHS), encoder_for(SensorSettings()), speed=4.0) as port, open(writer) as log:
        settings = Settings(sensor=SensorSettings(port=port.path))
        daemon = SpawnedDaemon(settings, tmp_path, log)
        try:
            assert any(isinstance(event, TouchEnded) for event in daemon.events())
            asked_s = time.monotonic()
            assert daemon.stop() == 0
            assert time.monotonic() - asked_s < 2 * AT_ONCE_S
        finally:
            daemon.stop()
    os.close(reader)


def test_lines_of_the_log_that_nobody_read_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LinesSink, "capacity", 3)
    reader, writer = os.pipe()
    log = LogWriter(writer)
    for number in range(10):
        log.handle(record(f"line {number}", line=number))
    log.start()
    log.stop(WITHIN_S)
    os.close(writer)
    with open(reader) as file:
        lines = [line.partition(": ")[2] for line in file.read().splitlines()]
    gap = "7 lines of the log were dropped: nobody read them"
    assert lines == [gap, "line 7", "line 8", "line 9"]


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


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "events.jsonl"


@pytest.mark.parametrize("content", [b"%PDF-1.7\n" + os.urandom(50_000), b'{"name": "settings"}', b"\n"])
def test_a_file_that_is_not_a_journal_is_refused_untouched(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(JournalError, match="is not a journal of touchd; it was left as it is"):
        Journal(path, max_bytes=1000, keep=1)
    assert path.read_bytes() == content


def test_a_device_or_pipe_is_refused_as_journal(path: Path) -> None:
    os.mkfifo(path)
    for wrong in (Path("/dev/null"), path, path.parent):
        with pytest.raises(JournalError, match="is not a file"):
            Journal(wrong, max_bytes=1000, keep=1)


def test_two_daemons_do_not_write_one_journal(path: Path) -> None:
    first = Journal(path, max_bytes=200, keep=1)
    for number in range(10):
        first.append(encode(touch(number)))
        # The lock also holds while the journal rotates.
        with pytest.raises(JournalError, match="another touchd writes it"):
            Journal(path, max_bytes=200, keep=1)
    first.close()
    Journal(path, max_bytes=200, keep=1).close()


@pytest.mark.parametrize("take_away", [Path.unlink, lambda path: path.rename(path.with_name("moved"))])
def test_a_journal_taken_away_is_recreated_and_reported(
    path: Path, take_away: Callable[[Path], object], caplog: pytest.LogCaptureFixture
) -> None:
    journal = Journal(path, max_bytes=10_000, keep=1)
    journal.append(encode(touch(1)))
    take_away(path)
    journal.append(encode(touch(2)))
    journal.append(encode(touch(3)))
    journal.close()
    assert numbers(path) == [2, 3]
    assert caplog.text.count("was removed") == 1


def test_a_deleted_journal_folder_is_warned_of_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (folder := tmp_path / "state").mkdir()
    journal = Journal(folder / "events.jsonl", max_bytes=10_000, keep=1)
    shutil.rmtree(folder)
    for number in range(5):
        journal.append(encode(touch(number)))
    (warning,) = caplog.messages
    assert "No such file or directory; events cannot be saved" in warning
    folder.mkdir()
    journal.append(encode(touch(5)))
    journal.close()
    assert numbers(folder / "events.jsonl") == [5]


def numbers(path: Path) -> list[int]:
    """Return the numbers of the touches whose beginning a journal holds."""
    return [kept.began.touch for kept in gather(read_events(path)[0])]


# A deeply nested line, invalid times, times and numbers too large for a file format, and undecodable bytes.
BAD_LINES = [
    b'{"type":"touch_began","touch":' + b"[" * 20_000 + b"]" * 20_000 + b"}",
    *(
        b'{"type":"touch_began","touch":1,"sensor_ms":1,"time":"%s"}' % time
        for time in (b"garbage", b"", b"1931-01-01T00:00:00.000Z", b"9999-01-01T00:00:00.000Z", b"2026-13-01")
    ),
    encode(PREDICTION).replace(b'"elapsed_s":1.0', b'"elapsed_s":1e308'),
    b'{"type":"touch_began","touch":' + b"9" * 400 + b',"sensor_ms":1,"time":"2026-11-20T10:00:00.000Z"}',
    b"\xff\xfe",
]


@pytest.mark.parametrize("suffix", ["csv", "mcap"])
@pytest.mark.parametrize("line", BAD_LINES, ids=range(len(BAD_LINES)))
def test_a_bad_line_does_not_stop_a_journals_readers(path: Path, suffix: str, line: bytes) -> None:
    pytest.importorskip(suffix)
    ended = TouchEnded(touch=1, gesture="pat", frames=9, reason="released", time="2026-11-20T10:00:01.000Z")
    path.write_bytes(b"\n".join([encode(touch(1)), line, encode(ended)]) + b"\n")
    out = path.with_name(f"out.{suffix}")
    assert cli.main(["convert", str(path), "-o", str(out)]) == 0
    assert out.stat().st_size > 100
    (found,) = gather(read_events(path)[0])
    assert found.ended == ended


@pytest.mark.parametrize("name", ["2026-11-20T10-00-00.000Z-1-1.csv.gz", f"{PARTIAL}x"])
def test_a_folder_named_like_a_touch_does_not_stop_deletion(tmp_path: Path, name: str) -> None:
    (tmp_path / "touches" / name).mkdir(parents=True)
    store = TouchStore(tmp_path / "touches", 3, "a made pad")
    for number in range(8):
        store.add(ended_touch(number))
    kept = kept_touches(tmp_path / "touches")
    assert [touch.number for touch in kept] == [5, 6, 7]
    assert (tmp_path / "touches" / name).is_dir()


def test_recordings_of_people_are_as_private_as_the_journal(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        TouchStore(tmp_path / "touches", 3, "a made pad").add(ended_touch(1))
        Journal(tmp_path / "events.jsonl", max_bytes=10_000, keep=1).close()
        (kept,) = kept_touches(tmp_path / "touches")
        converted = tmp_path / "copy.mcap"
        assert cli.main(["convert", str(kept.path), "-o", str(converted)]) == 0
    finally:
        os.umask(before)
    for file in (tmp_path / "events.jsonl", kept.path, converted):
        assert stat.S_IMODE(file.stat().st_mode) == 0o640


def test_a_hole_in_the_numbers_hides_no_older_file(path: Path) -> None:
    for number, name in enumerate(("events.jsonl.5", "events.jsonl.2", "events.jsonl"), 1):
        label = Label(touch=number, began="", gesture="pat", time="2026-11-20T10:00:00.000Z")
        path.with_name(name).write_bytes(encode(label) + b"\n")
    assert [touch for _, touch in sorted(read_labels(path, "pad"))] == [1, 2, 3]


def test_a_clock_that_was_ahead_does_not_delete_new_touches(tmp_path: Path) -> None:
    store = TouchStore(tmp_path, 3, "")
    for number in (1, 2, 3):
        store.add(ended_touch(number, after_s=1e8))
    for number in (4, 5):
        TouchStore(tmp_path, 3, "").add(ended_touch(number))
    assert [kept.number for kept in kept_touches(tmp_path)] == [3, 4, 5]


class Line:
    """A pipeline fed by a made pad on a line that can delay frames; clocks in seconds."""

    def __init__(self, step_ms: float = 1000 / 54, clock_factor: float = 1.0, back_ms: int = 0) -> None:
        self.events: list[Event] = []
        self.now_s, self.sensor_ms, self.sent = 1000.0, 5000.0, 0
        self._step_ms, self._clock_factor, self._back_ms = step_ms, clock_factor, back_ms
        self._pad = MadePad()
        clock = Clock(monotonic_s=lambda: self.now_s, epoch_s=lambda: 1795168800.0 + self.now_s)
        self._pipeline = Pipeline(PipelineSettings(), Scripted(), self.events.append, clock)

    def feel(self, *pressures: Scans, held_up: bool = False) -> list[Prediction]:
        """Send what the pad feels; return the answers to it."""
        before = len(self.events)
        for counts in self._pad.counts(np.concatenate(pressures)):
            self.sent += 1
            self.sensor_ms += self._step_ms * self._clock_factor
            self.now_s += 0.0 if held_up else self._step_ms / 1000
            # back_ms simulates a second board whose frames come in between.
            sensor_ms = round(self.sensor_ms) - self._back_ms * (self.sent % 2)
            self._pipeline.on_frame(Frame(sensor_ms % 2**32, self.now_s, counts))
        return [event for event in self.events[before:] if isinstance(event, Prediction)]


def test_old_touches_are_not_told_and_carry_their_age() -> None:
    line = Line()
    fresh, *_ = line.feel(nothing(1.5), palm(1.2), nothing(1.5))
    assert fresh.told
    assert fresh.age_ms < 50
    # The line stalls during the touch and 9 s of rest, then all frames arrive at once.
    line.now_s += 10.5
    old = line.feel(palm(1.2), nothing(9.3), held_up=True)
    assert old
    assert not any(answer.told for answer in old)
    assert all(8000 < answer.age_ms < 11000 for answer in old)
    *_, again = line.feel(nothing(0.5), palm(1.2))
    assert again.told
    assert again.age_ms < 500


def test_a_pad_played_at_half_speed_is_not_late() -> None:
    answers = Line(step_ms=2000 / 54, clock_factor=0.5).feel(nothing(1.5), *[palm(1.2), nothing(1.5)] * 5)
    assert all(answer.age_ms < 1000 for answer in answers)
    assert any(answer.told for answer in answers)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (Line(step_ms=250), "4.0 frames a second come"),
        (Line(back_ms=4000), "frames come with gaps; are they lost on the way, or do two boards send there"),
    ],
    ids=["4 Hz", "two boards"],
)
def test_a_pad_without_detectable_touches_is_degraded_with_a_reason(line: Line, why: str) -> None:
    line.feel(nothing(6.0))
    (event,) = line.events
    assert event.state == "degraded"
    assert why in event.reason
    line._step_ms, line._clock_factor, line._back_ms = 1000 / 54, 1.0, 0
    line.feel(nothing(7.0))
    assert line.events[-1].state == "up"


def test_a_small_file_of_countless_recordings_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.csv.gz"
    one = Recording("p", "s", "c", "rub", np.zeros((1, 8, 8), np.uint16), np.zeros(1, np.int64), "live")
    parts = [replace(one, participant=f"p{number % 2}") for number in range(10_002)]
    write_recordings(path, parts, {})
    with pytest.raises(RecordingError, match="more than 10000 recordings"):
        read_recordings(path)


def test_a_lasting_delay_is_forgotten_within_fifty_times_its_length() -> None:
    staleness = Staleness()

    def played(first_s: float, last_s: float, late_s: float) -> float:
        for pad_s in np.arange(first_s, last_s, 1 / 54):
            frame = GridFrame(0, 1000.0 * pad_s, pad_s + late_s, np.zeros((8, 8), np.float32), False, False)
            staleness.update(frame)
        return staleness.age_s(frame, frame.host_s)

    assert played(0.0, 2.0, 0.0) == pytest.approx(0.0, abs=1e-6)
    assert played(2.0, 7.0, 1.0) == pytest.approx(0.9, abs=0.01)
    assert played(7.0, 60.0, 1.0) == pytest.approx(0.0, abs=1e-6)
    # After a reset of the board its clock restarts, but its frames are not older.
    assert played(0.5, 1.0, 60.0) == pytest.approx(0.0, abs=1e-6)
