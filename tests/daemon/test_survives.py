"""External faults: the daemon keeps running, reports them, and destroys nothing."""

import os
import socket
import stat
import time
from contextlib import suppress
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from rigs.ended_touch import ended_touch
from rigs.expectations import LENGTHS, stream_of
from rigs.live_rig import HANDSHAKE, Served, frames_among
from rigs.made_pad import MadePad, Scans, nothing, palm
from rigs.scripted_model import Scripted
from rigs.terminal import Terminal
from rigs.wait import AT_ONCE_S, WITHIN_S, once_in_three

from touchd.daemon.app import cli
from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.live.viewers import Connection
from touchd.daemon.path.events import Event, Prediction, TouchEnded
from touchd.daemon.path.pipeline import Clock, Pipeline, PipelineSettings
from touchd.daemon.playback.rig import SpawnedDaemon, encoder_for
from touchd.daemon.sinks.journal import Journal
from touchd.daemon.sinks.touch_store import TouchStore, saved_touches
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Frame

PING = b"\x89\xbc" + bytes(4) + bytes(60)
EMPTY_TEXT = b"\x01\x80" + bytes(4)
EMPTY_CONTINUATION = b"\x00\x80" + bytes(4)


@pytest.mark.parametrize("said", [PING, EMPTY_CONTINUATION], ids=["pings", "empty fragments"])
def test_a_flooding_viewer_is_disconnected(served: Served, said: bytes) -> None:
    # By itself, the kernel's buffer grows to tens of megabytes.
    served.sink.listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65_536)
    received = Connection.data_received
    seen = patch.object(Connection, "data_received", autospec=True, side_effect=received)
    with (
        seen as reads,
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
        # What is read at once takes forty times its size if it consists of empty fragments.
        assert max(len(data) for (_, data), _ in reads.call_args_list) <= 4096
        frames_among(viewer, served.put_frame())


def test_a_view_ends_cleanly_when_its_terminal_is_closed() -> None:
    stream = stream_of(LENGTHS)
    with (
        FakePort(stream, encoder_for(SensorSettings()), loop=True) as port,
        Terminal("run", "--view", "--port", port.path) as terminal,
    ):
        terminal.until(port.path)
        terminal.close()
        terminal.process.terminate()
        assert terminal.process.wait(WITHIN_S) == 0


@once_in_three
def test_a_log_that_nobody_reads_stops_nothing(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with suppress(BlockingIOError):
        while True:
            os.write(writer, b"x" * 65536)
    os.set_blocking(writer, True)
    with FakePort(stream_of(LENGTHS), encoder_for(SensorSettings()), speed=16.0) as port, open(writer) as log:
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


def test_recordings_of_people_are_as_private_as_the_journal(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        TouchStore(tmp_path / "touches", 3, "a made pad").add(ended_touch(1))
        Journal(tmp_path / "events.jsonl", max_bytes=10_000, keep=1).close()
        (kept,) = saved_touches(tmp_path / "touches")
        converted = tmp_path / "copy.mcap"
        assert cli.main(["convert", str(kept.path), "-o", str(converted)]) == 0
    finally:
        os.umask(before)
    for file in (tmp_path / "events.jsonl", kept.path, converted):
        assert stat.S_IMODE(file.stat().st_mode) == 0o640


class Line:
    """A pipeline fed by a made pad on a line that can delay frames. speed: of the pad, by its own clock."""

    def __init__(self, speed: float = 1.0) -> None:
        self.now_s, self._sensor_ms, self._speed = 1000.0, 5000.0, speed
        self._events: list[Event] = []
        self._pad = MadePad()
        clock = Clock(monotonic_s=lambda: self.now_s, epoch_s=lambda: 1795168800.0 + self.now_s)
        self._pipeline = Pipeline(PipelineSettings(), Scripted(), self._events.append, clock)

    def feel(self, *pressures: Scans, held_up: bool = False) -> list[Prediction]:
        """Send what the pad feels; return the answers to it."""
        before = len(self._events)
        for counts in self._pad.counts(np.concatenate(pressures)):
            self._sensor_ms += 1000 / 54
            self.now_s += 0.0 if held_up else 1 / 54 / self._speed
            self._pipeline.on_frame(Frame(round(self._sensor_ms), self.now_s, counts))
        return [event for event in self._events[before:] if isinstance(event, Prediction)]


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
    answers = Line(speed=0.5).feel(nothing(1.5), *[palm(1.2), nothing(1.5)] * 5)
    assert all(answer.age_ms < 1000 for answer in answers)
    assert any(answer.told for answer in answers)
