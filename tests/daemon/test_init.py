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

from daemon.commands import init
from daemon.commands.init import main
from daemon.config import ConfigError, SensorSettings, load
from daemon.events import SensorEvent, decode
from daemon.setup.destinations import encoder_for
from drivers.fakes.fake_port import FakePort
from drivers.pad.format import PRESETS, PadFormat

STREAM = stream_of(next(iter(RECORDINGS)))
ENCODE = encoder_for(SensorSettings())


class Found:
    """A port as the operating system lists it."""

    def __init__(self, device: str) -> None:
        self.device = device


def test_the_pads_port_and_slow_baud_rate_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "touchd.yaml"
    pad = pad_at_baud(STREAM.counts, termios.B57600)
    monkeypatch.setattr(init, "USUAL_BAUDS", (115_200, 57_600))
    monkeypatch.setattr(init, "DEFAULT_PORT", str(tmp_path / "none"))
    monkeypatch.setattr(init, "comports", lambda: [Found("/dev/null"), Found(pad.path)])
    with pad:
        assert main([str(path), "--robot", "none"]) == 0
    settings = load(path)
    assert settings.sensor.described == SensorSettings().described
    assert (settings.sensor.port, settings.sensor.baud) == (pad.path, 57_600)
    with pytest.raises(ConfigError, match="is there already"):
        main([str(path)])


def test_an_unknown_pad_is_found_at_its_baud_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = PadFormat(header="aa55", rows=8, columns=8, cell="u8", full_scale=255)
    path = tmp_path / "touchd.yaml"
    monkeypatch.setattr(init, "USUAL_BAUDS", (115_200, 57_600))
    rest = np.random.default_rng(0).integers(0, 24, (4000, 8, 8)).astype(np.uint16)
    with pad_read_too_fast(rest, termios.B57600, own) as pad:
        assert main([str(path), "--port", pad.path, "--robot", "none"]) == 0
    sensor = load(path).sensor
    assert (sensor.baud, str(sensor.described)) == (57_600, str(own))


def test_devices_that_are_silent_are_sent_nothing_where_a_pad_sends_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(init, "FIRST_BYTE_S", 0.3)
    monkeypatch.setattr(init, "DEFAULT_PORT", str(tmp_path / "none"))
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    with FakePort(STREAM, ENCODE, loop=True) as pad:
        monkeypatch.setattr(init, "comports", lambda: [Found(os.ttyname(slave)), Found(pad.path)])
        monkeypatch.setattr(init, "sorted", list, raising=False)
        assert main([str(tmp_path / "touchd.yaml"), "--robot", "none"]) == 0
    with pytest.raises(BlockingIOError):
        os.read(master, 64)
    os.close(slave)
    os.close(master)
    assert load(tmp_path / "touchd.yaml").sensor.port == pad.path


def test_a_pad_whose_clock_stands_still_is_told_and_no_other_is_invented(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "touchd.yaml"
    with FakePort(STREAM, lambda counts, _: ENCODE(counts, 7), loop=True) as port:
        main([str(path), "--port", port.path, "--baud", "115200", "--robot", "none"])
    assert "frames of fabric-grid 10x10 arrive, but their clock stands still" in capsys.readouterr().err
    assert load(path).sensor.described == PRESETS["fabric-grid"]


def test_no_address_can_break_the_file(tmp_path: Path) -> None:
    path = tmp_path / "touchd.yaml"
    address = 'x: {"y": # 😀'
    assert main([str(path), "--port", str(tmp_path / address), "--baud", "9600", "--robot", address]) == 1
    settings = load(path)
    assert settings.sensor.port == str(tmp_path / address)
    assert settings.robot is not None
    assert settings.robot.url == address


def test_a_file_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    options = ["--port", str(tmp_path / "Größe 😀"), "--baud", "9600", "--robot", "none"]
    with pytest.raises(ConfigError, match=r"cannot be written .*; give another path"):
        main([str(tmp_path / "missing/touchd.yaml"), *options])
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, text: str, encoding: str) -> None:
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(ConfigError, match="No space left on device"):
        main([str(tmp_path / "touchd.yaml"), "--port", str(tmp_path / "none"), "--robot", "none"])
    assert list(tmp_path.iterdir()) == []


def test_a_pad_that_only_answers_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "touchd.yaml"
    monkeypatch.setattr(init, "FIRST_BYTE_S", 0.3)
    master, slave = pty.openpty()
    tty.setraw(slave)
    described = PRESETS["fsr-array"]
    pad = PolledPad(described, lambda: os.read(master, 64), lambda data: os.write(master, data))
    try:
        assert main([str(path), "--port", os.ttyname(slave), "--baud", "9600", "--robot", "none"]) == 0
    finally:
        os.close(slave)
        pad.join()
        os.close(master)
    assert load(path).sensor.format == "fsr-array"


def test_the_file_is_written_even_without_a_pad(tmp_path: Path) -> None:
    path = tmp_path / "touchd.yaml"
    assert main([str(path), "--port", str(tmp_path / "none"), "--baud", "115200", "--robot", "none"]) == 1
    assert load(path).sensor.described == SensorSettings().described


def test_the_end_of_input_means_no_robot(tmp_path: Path) -> None:
    path = tmp_path / "touchd.yaml"
    with (
        FakePort(STREAM, ENCODE, loop=True) as port,
        Terminal("init", str(path), "--port", port.path, "--baud", "115200") as terminal,
    ):
        terminal.until("(Enter: no robot): ")
        terminal.answer("\x04", " doctor -c")
    assert load(path).robot is None


def test_the_robot_is_asked_for_tried_and_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "touchd.yaml"
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    with Robot() as robot, FakePort(STREAM, ENCODE, loop=True) as port:
        with Terminal("init", str(path), "--port", port.path, "--baud", "115200") as terminal:
            terminal.until("The robot's address")
            terminal.answer("nao.local", "is not an address such as tcp://nao.local:9559")
            terminal.until("The robot's address")
            terminal.answer(robot.url)
            assert "pad: fabric-grid 10x10" in terminal.until("robot: ")
            assert robot.url in terminal.until(" doctor -c")
            assert terminal.process.wait(WITHIN_S) == 0
        assert load(path).robot is not None
        with Program(*TOUCHD, "run", "-c", path, stderr=subprocess.DEVNULL) as daemon:
            robot.calls.wait_for_raise("TouchGesture/Status", "up")
            first = next(decode(line) for line in daemon.stdout if "sensor" in line)
            assert isinstance(first, SensorEvent)
            daemon.terminate()
            assert daemon.wait(WITHIN_S) == 0
    assert (tmp_path / "state/touchd/events.jsonl").stat().st_size > 0
