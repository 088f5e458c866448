"""The sensor delivers every intact frame at once, and again when a fault of the cable is over."""

import logging
import socket
import subprocess
import sys
import termios
import threading
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
import serial
from rigs.formats import CsvLines, FabricGrid, encode_csv_line, encode_fabric_grid
from rigs.line_faults import NO_FAULTS, Faults, FaultyPort
from rigs.sensor_rig import (
    BAUD,
    Encode,
    Switch,
    as_8x8,
    assert_played,
    next_frames,
    next_state,
    noise,
    sensing,
    silence,
    stream_of,
)
from rigs.wait import WITHIN_S, once_in_three, wait_for

from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Counts, Frame, SensorState
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.sensor import FrameQueue, Sensor


@pytest.mark.parametrize(
    ("faults", "lost"),
    [
        (NO_FAULTS, []),
        (Faults(chunk_bytes=1), []),
        (Faults(drop_frame_every=5), [4, 9, 14, 19, 24, 29]),
        (Faults(flip_bit_every=5, garbage_every=3), [4, 9, 14, 19, 24, 29]),
        (Faults(cut_frame_every=10, repeat_frame_every=4), [9, 19, 29]),
    ],
)
def test_up_comes_first_then_every_intact_frame_once(faults: Faults, lost: list[int]) -> None:
    stream = stream_of(32)
    intact = [index for index in range(32) if index not in lost]
    with (
        FaultyPort(stream, encode_fabric_grid, speed=20.0, faults=faults) as port,
        sensing(port.path) as queue,
    ):
        assert queue.get(WITHIN_S) == SensorState("up", f"frames arrive from {port.path}")
        frames = next_frames(queue, len(intact))
    assert_played(frames, stream, intact)


def without_clock(counts: Counts, sensor_ms: int) -> bytes:
    return encode_csv_line(counts, sensor_ms).partition(b",")[2]


WITHOUT_CLOCK = PadFormat(framing="text", rows=10, columns=10, crop=1)


@pytest.mark.parametrize(
    ("encode", "parser", "together", "read"),
    [
        (encode_fabric_grid, FabricGrid(), 3, 3),
        (encode_fabric_grid, FabricGrid(), 1, 1),
        (without_clock, FrameParser(WITHOUT_CLOCK), 3, 1),
    ],
    ids=["quiet", "touched", "quiet, without a clock"],
)
def test_three_frames_of_a_quiet_pad_are_read_together(
    encode: Encode, parser: FrameParser, together: int, read: int
) -> None:
    queue = FrameQueue()

    def is_as_wanted() -> bool:
        frames = next_frames(queue, 50)
        return 0.7 * read < len(frames) / len({frame.host_s for frame in frames}) < 1.7 * read

    with FakePort(stream_of(200), encode, loop=True) as port:
        sensor = Sensor(port.path, BAUD, parser, queue)
        sensor.frames_together = together
        sensor.start()
        # A busy machine delays some reads, which then bring more frames; shorter ones follow.
        assert any(is_as_wanted() for _ in range(5))
        sensor.stop()
    assert parser.counts.bad == queue.dropped == 0


@once_in_three
def test_a_fast_pads_frames_do_not_fill_its_port() -> None:
    queue = FrameQueue()
    with FakePort(stream_of(500), encode_fabric_grid, speed=9.0) as port:
        sensor = Sensor(port.path, BAUD, FabricGrid(), queue)
        sensor.frames_together = 3
        sensor.start()
        arrivals_s = [frame.host_s for frame in next_frames(queue, 500)[300:]]
        sensor.stop()
    # Linux keeps 4096 bytes, which are 19 frames. A busy machine delays some of the reads.
    assert np.quantile(list(Counter(arrivals_s).values()), 0.9) < 15


def test_a_full_queue_drops_old_frames_but_no_state() -> None:
    queue = FrameQueue(4)
    down, up = SensorState("down", "unplugged"), SensorState("up", "back")
    frames = [Frame(number * 19, 0.0, np.zeros((8, 8), np.uint16)) for number in range(4)]
    for item in (down, frames[0], up, *frames[1:]):
        queue.put(item)
    assert (len(queue), queue.dropped) == (4, 2)
    assert queue.take_all() == [down, up, frames[2], frames[3]]
    assert queue.get(0.01) is None
    for state in [down, down, up] * 4:
        queue.put(state)
    assert queue.take_all() == [up, down, down, up]


def test_it_stops_at_once_in_any_state(tmp_path: Path) -> None:
    Sensor("/dev/none", BAUD, FabricGrid(), FrameQueue()).stop()
    with sensing(str(tmp_path / "none")) as queue:
        next_state(queue)
    flood = FakePort(stream_of(), encode_fabric_grid, speed=1e6, loop=True)
    with flood as port, sensing(port.path) as queue:
        next_frames(queue, 100)


STEAL = """
import os, select, sys
line = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
while True:
    select.select([line], [], [])
    try: os.read(line, 4096)
    except BlockingIOError: pass
"""


@pytest.fixture(autouse=True)
def _all_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)


def assert_is_over(queue: FrameQueue, caplog: pytest.LogCaptureFixture, *levels: str) -> None:
    """Assert that frames arrive before the port would be reopened, with these log levels only."""
    begun_s = time.monotonic()
    assert next_state(queue).state == "up"
    next_frames(queue, 5)
    assert time.monotonic() - begun_s < 10.0
    assert [record.levelname for record in caplog.records] == list(levels)


def test_a_silent_pad_is_down_until_it_sends_again(caplog: pytest.LogCaptureFixture) -> None:
    switch = Switch(encode_fabric_grid)
    with FakePort(stream_of(), switch) as port, sensing(port.path, silence_s=Sensor.silence_s) as queue:
        next_frames(queue, 5)
        switch.encode = silence
        assert next_state(queue).reason.startswith(f"{port.path} at 512000 baud: no data for 2 s")
        switch.encode = encode_fabric_grid
        assert_is_over(queue, caplog, "INFO", "WARNING", "INFO")
    assert caplog.records[-1].message.startswith(f"frames arrive from {port.path} again; ")


def test_a_board_that_starts_late_is_not_another_pad(
    caplog: pytest.LogCaptureFixture,
) -> None:
    # As an Arduino does: opening the port restarts it, and its boot loader takes a second or two.
    def late(counts: Counts, sensor_ms: int) -> bytes:
        return encode_csv_line(counts, sensor_ms) if sensor_ms > 1800 else b""

    with FakePort(stream_of(), late) as port, sensing(port.path, CsvLines(), silence_s=1.5) as queue:
        next_frames(queue, 30)
    assert "no frame" not in caplog.text


@pytest.mark.parametrize(
    ("sent", "options"),
    [
        (b"", {"reopen_after_s": 0.2}),
        (b"", {"silence_s": 0.1, "frameless_s": 0.3}),
        (b"no frame, but text\n", {"silence_s": 0.1, "frameless_s": 0.3}),
        (noise(stream_of(1).counts[0], 7), {"silence_s": 0.1, "frameless_s": 0.3}),
    ],
    ids=["no byte", "no frame", "text", "noise"],
)
def test_a_port_long_without_frames_is_reopened(sent: bytes, options: dict[str, float]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(WITHIN_S)
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with sensing(address, **options), server.accept()[0] as first:
            first.sendall(sent)
            with server.accept()[0]:
                pass


def test_a_port_that_another_program_reconfigured_is_restored() -> None:
    with FakePort(stream_of(), encode_fabric_grid) as port, sensing(port.path, frameless_s=1.0) as queue:
        next_frames(queue, 5)
        # What `stty istrip` does: the header's bytes lose their highest bit.
        with open(port.path, "rb") as line:
            flags = termios.tcgetattr(line)
            flags[0] |= termios.ISTRIP
            termios.tcsetattr(line, termios.TCSANOW, flags)
        assert "but no frame of" in next_state(queue).reason
        assert next_state(queue).state == "up"
        next_frames(queue, 5)


def test_a_reader_stopped_during_a_lookup_reports_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchd.drivers.pad.port.CONNECT_S", 0.3)
    with socket.create_server(("127.0.0.1", 0), backlog=0) as deaf, ExitStack() as waiting:
        # A full backlog: further connections are neither taken nor refused, as by a board that is off.
        for _ in range(3):
            caller = waiting.enter_context(socket.socket())
            caller.setblocking(False)
            caller.connect_ex(deaf.getsockname())
        queue = FrameQueue()
        sensor = Sensor(f"tcp://127.0.0.1:{deaf.getsockname()[1]}", 0, FabricGrid(), queue)
        sensor.start()
        sensor.stop(0.1)
        wait_for(lambda: "touchd-sensor" not in [thread.name for thread in threading.enumerate()])
    assert len(queue) == 0


def test_bytes_without_frames_are_reported_until_frames_come(caplog: pytest.LogCaptureFixture) -> None:
    switch = Switch(as_8x8)
    with FakePort(stream_of(), switch) as port, sensing(port.path) as queue:
        reason = f"{port.path} at 512000 baud: bytes come, but no frame of fabric-grid 10x10; touchd doctor"
        assert next_state(queue).reason.startswith(reason)
        switch.encode = encode_fabric_grid
        assert_is_over(queue, caplog, "WARNING", "INFO")


def test_a_loose_plug_is_warned_of_once(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    link = tmp_path / "touchd-pad"
    with sensing(str(link)) as queue:
        for _ in range(4):
            with FakePort(stream_of(), encode_fabric_grid) as port:
                link.unlink(missing_ok=True)
                link.symlink_to(port.path)
                while next_state(queue).state != "up":
                    pass
            assert next_state(queue).state == "down"
    assert [record.levelname for record in caplog.records] == ["WARNING", "INFO"]


def test_a_busy_port_is_opened_once_it_is_free(caplog: pytest.LogCaptureFixture) -> None:
    with FakePort(stream_of(), encode_fabric_grid) as port:
        other = serial.Serial(port.path, exclusive=True)
        with sensing(port.path) as queue:
            assert "is open in another program" in next_state(queue).reason
            other.close()
            assert_is_over(queue, caplog, "WARNING", "INFO")


def test_an_internal_error_is_reported_while_it_lasts() -> None:
    class Fragile(FabricGrid):
        broken = True

        def feed(self, data: bytes, host_s: float) -> list[Frame]:
            if self.broken:
                raise ZeroDivisionError("unforeseen")
            return super().feed(data, host_s)

    protocol = Fragile()
    with FakePort(stream_of(), encode_fabric_grid) as port, sensing(port.path, protocol) as queue:
        assert "internal error" in next_state(queue).reason
        protocol.broken = False
        assert next_state(queue).state == "up"


def test_another_program_that_takes_bytes_is_reported_until_it_ends() -> None:
    with FakePort(stream_of(), encode_fabric_grid) as port, sensing(port.path) as queue:
        next_frames(queue, 5)
        with subprocess.Popen([sys.executable, "-c", STEAL, port.path]) as process:
            try:
                while isinstance(item := queue.get(WITHIN_S), Frame):
                    last_s = item.host_s
            finally:
                process.kill()
        assert isinstance(item, SensorState)
        assert item.reason.startswith(
            f"{port.path} is read by another program too, which takes bytes; end it; "
        )
        # The port stays open: opening it again would restart an Arduino.
        assert next_state(queue).state == "up"
        assert next_frames(queue, 5)[0].host_s - last_s > 0.5


def test_a_pad_that_returns_under_another_name_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("touchd.drivers.pad.port.DEV", tmp_path)
    with sensing(str(tmp_path / "ttyACM0")) as queue:
        assert next_state(queue).reason == f"{tmp_path}/ttyACM0 is not there; touchd doctor says more"
        (tmp_path / "ttyACM1").touch()
        assert f"is not there; there is {tmp_path}/ttyACM1; " in next_state(queue).reason
