"""`touchd init`: finds pad and robot, and writes a configuration that runs."""

import errno
import os
import pty
import subprocess
import termios
import tty
from pathlib import Path

import numpy as np
import pytest
from rigs.doctor_rig import pad_at_baud, pad_read_too_fast
from rigs.expectations import RECORDINGS, stream_of
from rigs.programs import TOUCHD, Program
from rigs.robots import Robot
from rigs.sensor_rig import PolledPad
from rigs.terminal import Terminal
from rigs.wait import WITHIN_S

from touchd.daemon.commands import init
from touchd.daemon.commands.init import main
from touchd.daemon.config import ConfigError, SensorSettings, load
from touchd.daemon.events import SensorEvent, decode
from touchd.daemon.setup.destinations import encoder_for
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.pad.format import PRESETS, PadFormat

STREAM = stream_of(next(iter(RECORDINGS)))
ENCODE = encoder_for(SensorSettings())
FILE = Path("touchd.yaml")


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def write(*options: str) -> int:
    """Run the command for a lab without a robot."""
    return main(["--robot", "none", *options])


class Found:
    """A port as the operating system lists it."""

    def __init__(self, device: str) -> None:
        self.device = device


def test_the_pads_port_and_slow_baud_rate_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    pad = pad_at_baud(STREAM.counts, termios.B57600)
    monkeypatch.setattr(init, "USUAL_BAUDS", (115_200, 57_600))
    monkeypatch.setattr(init, "DEFAULT_PORT", "none")
    monkeypatch.setattr(init, "comports", lambda: [Found("/dev/null"), Found(pad.path)])
    with pad:
        assert write() == 0
    settings = load(FILE)
    assert settings.sensor.described == SensorSettings().described
    assert (settings.sensor.port, settings.sensor.baud) == (pad.path, 57_600)
    with pytest.raises(ConfigError, match="is there already"):
        write()


def test_an_unknown_pad_is_found_at_its_baud_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    own = PadFormat(header="aa55", rows=8, columns=8, cell="u8", full_scale=255)
    monkeypatch.setattr(init, "USUAL_BAUDS", (115_200, 57_600))
    rest = np.random.default_rng(0).integers(0, 24, (4000, 8, 8)).astype(np.uint16)
    with pad_read_too_fast(rest, termios.B57600, own) as pad:
        assert write("--port", pad.path) == 0
    sensor = load(FILE).sensor
    assert (sensor.baud, str(sensor.described)) == (57_600, str(own))


def test_silent_devices_are_sent_nothing_where_a_pad_sends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(init, "FIRST_BYTE_S", 0.3)
    monkeypatch.setattr(init, "DEFAULT_PORT", "none")
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    with FakePort(STREAM, ENCODE, loop=True) as pad:
        monkeypatch.setattr(init, "comports", lambda: [Found(os.ttyname(slave)), Found(pad.path)])
        monkeypatch.setattr(init, "sorted", list, raising=False)
        assert write() == 0
    with pytest.raises(BlockingIOError):
        os.read(master, 64)
    os.close(slave)
    os.close(master)
    assert load(FILE).sensor.port == pad.path


def test_a_standing_clock_is_told_and_no_pad_invented(capsys: pytest.CaptureFixture[str]) -> None:
    with FakePort(STREAM, lambda counts, _: ENCODE(counts, 7), loop=True) as port:
        write("--port", port.path, "--baud", "115200")
    assert "frames of fabric-grid 10x10 arrive, but their clock stands still" in capsys.readouterr().err
    assert load(FILE).sensor.described == PRESETS["fabric-grid"]


def test_no_address_can_break_the_file() -> None:
    address = 'x: {"y": # 😀'
    assert write("--port", address, "--baud", "9600", "--robot", address) == 1
    settings = load(FILE)
    assert settings.robot is not None
    assert settings.sensor.port == settings.robot.url == address


def test_a_file_that_cannot_be_written_is_told() -> None:
    with pytest.raises(ConfigError, match=r"cannot be written .*; give another path"):
        write("missing/touchd.yaml", "--port", "Größe 😀", "--baud", "9600")
    assert os.listdir() == []


def test_a_full_disk_leaves_no_file(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, text: str, encoding: str) -> None:
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(ConfigError, match="No space left on device"):
        write("--port", "none")
    assert os.listdir() == []


def test_a_pad_that_only_answers_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(init, "FIRST_BYTE_S", 0.3)
    master, slave = pty.openpty()
    tty.setraw(slave)
    described = PRESETS["fsr-array"]
    pad = PolledPad(described, lambda: os.read(master, 64), lambda data: os.write(master, data))
    try:
        assert write("--port", os.ttyname(slave), "--baud", "9600") == 0
    finally:
        os.close(slave)
        pad.join()
        os.close(master)
    assert load(FILE).sensor.format == "fsr-array"


def test_the_file_is_written_even_without_a_pad() -> None:
    assert write("--port", "none", "--baud", "115200") == 1
    assert load(FILE).sensor.described == SensorSettings().described


def test_the_end_of_input_means_no_robot() -> None:
    with (
        FakePort(STREAM, ENCODE, loop=True) as port,
        Terminal("init", "--port", port.path, "--baud", "115200") as terminal,
    ):
        terminal.until("(Enter: no robot): ")
        terminal.answer("\x04", " doctor -c")
    assert load(FILE).robot is None


def test_the_robot_is_asked_for_tried_and_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(Path("state").absolute()))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    with Robot() as robot, FakePort(STREAM, ENCODE, loop=True) as port:
        with Terminal("init", "--port", port.path, "--baud", "115200") as terminal:
            terminal.until("The robot's address")
            terminal.answer("nao.local", "is not an address such as tcp://nao.local:9559")
            terminal.until("The robot's address")
            terminal.answer(robot.url)
            assert "pad: fabric-grid 10x10" in terminal.until("robot: ")
            assert robot.url in terminal.until(" doctor -c")
            assert terminal.process.wait(WITHIN_S) == 0
        assert load(FILE).robot is not None
        with Program(*TOUCHD, "run", "-c", FILE, stderr=subprocess.DEVNULL) as daemon:
            robot.calls.wait_for_raise("TouchGesture/Status", "up")
            first = next(decode(line) for line in daemon.stdout if "sensor" in line)
            assert isinstance(first, SensorEvent)
            daemon.terminate()
            assert daemon.wait(WITHIN_S) == 0
    assert Path("state/touchd/events.jsonl").stat().st_size > 0
