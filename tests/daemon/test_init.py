"""`touchd init`: finds pad and robot, and writes a configuration that runs."""

import errno
import os
import termios
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
from msgspec.structs import replace
from rich.console import Console
from rigs.doctor_rig import pad_read_too_fast
from rigs.expectations import RECORDINGS, stream_of
from rigs.login_gate import Login
from rigs.pressing import SECONDS, pressed
from rigs.robots import LOGIN, Robot
from rigs.terminal import Terminal
from serial.tools.list_ports_common import ListPortInfo

from touchd.daemon.app.cli import options_of
from touchd.daemon.app.config import ConfigError, SensorSettings, load
from touchd.daemon.commands import init
from touchd.daemon.doctor import hand, machine
from touchd.daemon.doctor.hand import turned_with_a_hand
from touchd.daemon.playback.rig import encoder_for
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.pad.format import PRESETS, PadFormat
from touchd.drivers.pad.port import SensorError, open_port
from touchd.drivers.recording import Stream, ideal_clock_ms
from touchd.drivers.robot.session import RobotError
from touchd.drivers.search.listen import listen
from touchd.drivers.search.search import Finding

STREAM = stream_of(next(iter(RECORDINGS)))
ENCODE = encoder_for(SensorSettings())
FILE = Path("touchd.yaml")
Captured = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def main(words: list[str]) -> int:
    return init.main(options_of("init", words))


def write(*options: str) -> int:
    """Run the command for a lab without a robot."""
    return main(["--robot", "none", *options])


def test_the_pads_port_and_baud_rate_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(init, "USUAL_BAUDS", (115_200, 57_600))
    monkeypatch.setattr(init, "DEFAULT_PORT", "none")
    monkeypatch.setattr(hand, "LISTEN_S", 2.5)
    counts = wandering_then_held(1, 1, 0.0).counts
    with pad_read_too_fast(counts, termios.B57600, PRESETS["fabric-grid"], pace=1.0) as pad:
        monkeypatch.setattr(init, "comports", lambda: [ListPortInfo("/dev/null"), ListPortInfo(pad.path)])
        assert write() == 0
    settings = load(FILE)
    assert settings.sensor.described == SensorSettings().described
    assert (settings.sensor.port, settings.sensor.baud) == (pad.path, 57_600)
    with pytest.raises(ConfigError, match="is there already"):
        write()


@pytest.mark.parametrize("found", [init.Found("/dev/ttyACM0", 115_200, PRESETS["fabric-grid"]), None])
def test_a_port_is_written_by_a_name_that_lasts(
    found: init.Found | None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    lasting = tmp_path / "by-id"
    monkeypatch.setattr(init, "_find", lambda *_: found)
    monkeypatch.setattr(init, "lasting_name", lambda port: (str(lasting), "it stays"))
    assert write("--port", "/dev/ttyACM0") == (found is None)
    assert load(FILE).sensor.port == str(lasting)


@pytest.mark.parametrize("typed", ["16", "3x8", "8x65", "x", "8x8x8", "10\n"])
def test_an_invalid_grid_is_refused(typed: str, capsys: Captured) -> None:
    with pytest.raises(SystemExit):
        write("--grid", typed)
    said = f"{typed.strip()!r} is not ROWSxCOLUMNS of 4 to 64 each, as in 16x16"
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("columns", "told", "said"),
    [
        (10, [], "120 numbers a frame; say --grid ROWSxCOLUMNS"),
        (8, ["--grid", "12x8"], "press firmly"),
    ],
    ids=["the grid is missing", "nobody presses"],
)
def test_an_unproven_pad_is_refused_in_one_line(
    columns: int, told: list[str], said: str, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.setattr(hand, "LISTEN_S", 1.0)
    monkeypatch.setattr(hand, "LONGER_S", 0.1)
    rest = np.random.default_rng(0).integers(0, 4, (4000, 8, 8)).astype(np.uint16)
    printed = encoder_for(SensorSettings(format=PadFormat(framing="text", rows=12, columns=columns)))
    with FakePort(Stream(rest, ideal_clock_ms(len(rest)), ()), printed, loop=True) as pad:
        assert write("--port", pad.path, *told) == 1
    shown = capsys.readouterr().err
    assert "bytes/s of text, such as" in shown
    assert said in shown
    assert not FILE.exists()


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        (["--port", "."], SensorError, "is not a serial port"),
        (["--port", "tcp://10.0.0.5"], SensorError, "lacks its port"),
        (["--port", "none", "--robot", 'x: {"y": # 😀'], RobotError, "is not a robot's name or address"),
        (["--port", "none", "--robot", "http://nao"], RobotError, "'http://nao' is not a robot's name"),
        (["missing/touchd.yaml", "--port", "none"], ConfigError, r"cannot be written .*; give another path"),
    ],
)
def test_options_that_cannot_work_are_refused_at_once(
    options: list[str], kind: type[Exception], message: str, capsys: Captured
) -> None:
    with pytest.raises(kind, match=message):
        write(*options)
    assert os.listdir() == []
    assert capsys.readouterr().err == ""


def test_a_full_disk_leaves_no_file(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, text: str, encoding: str) -> None:
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(ConfigError, match="No space left on device"):
        write("--port", "none")
    assert os.listdir() == []


def test_without_pad_and_robot_the_file_has_the_likeliest(capsys: Captured) -> None:
    port, host = 'x: {"y": # 😀', "no-such-robot.invalid"
    assert main(["--port", port, "--baud", "9600", "--robot", host]) == 1
    settings = load(FILE)
    assert settings.sensor == SensorSettings(port=port, baud=9600)
    assert settings.robot is not None
    assert settings.robot.url == f"tcp://{host}:9559"
    assert f"trying tcp://{host}:9559 ...\ntrying tcps://{host}:9503 ...\n" in capsys.readouterr().err


def test_a_shared_port_is_not_a_missing_pad() -> None:
    with (
        FakePort(STREAM, ENCODE) as pad,
        serial.Serial(pad.path, exclusive=True),
        pytest.raises(SensorError, match=r"is open in another program; end the other program \("),
    ):
        write("--port", pad.path)
    assert not FILE.exists()


@pytest.mark.parametrize("changed", [{}, {"rows": 8, "columns": 8, "crop": 0, "turn": 90, "mirror": True}])
def test_what_was_found_is_written(monkeypatch: pytest.MonkeyPatch, changed: dict[str, Any]) -> None:
    found = replace(PRESETS["fabric-grid"], **changed)
    monkeypatch.setattr(init, "_find", lambda *_: init.Found("none", 512_000, found))
    assert write() == 0
    sensor = load(FILE).sensor
    assert (sensor.described, sensor.turn) == (found, found.turn)
    assert isinstance(sensor.format, str) is not bool(changed)


@pytest.mark.parametrize(
    ("login", "said"),
    [
        (None, "robot: NAOqi 2.8.7.4 at {}"),
        (LOGIN, "probably asks for a login (looking for ALSystem: disconnected); set robot.token_file"),
    ],
)
def test_a_robots_name_finds_its_protocol_and_port(
    login: Login | None, said: str, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    with Robot(login=login) as robot:
        port = int(robot.url.rpartition(":")[2])
        for typed in ("localhost", f"tcp://localhost:{port}"):
            scheme = "tcps" if login else "tcp"
            monkeypatch.setattr(machine, "ROBOT_PORTS", {"tcp": 1, "tcps": 1} | {scheme: port})
            main(["--port", "none", "--robot", typed])
            found = load(FILE).robot
            assert found is not None
            assert found.url == f"{scheme}://localhost:{port}"
            assert (found.certificate or "").startswith("sha256:") == (login is not None)
            assert said.format(found.url) in capsys.readouterr().err
            FILE.unlink()


def test_a_grid_that_only_one_search_found_is_not_proposed(monkeypatch: pytest.MonkeyPatch) -> None:
    early, found, firmer = (
        Finding(replace(PRESETS["velostat"], columns=columns, full_scale=scale), "", "")
        for columns, scale in ((4, 1023), (8, 1023), (8, 4095))
    )
    searches = iter([early, found, firmer])
    monkeypatch.setattr(hand, "listen", lambda *_: [])
    monkeypatch.setattr(hand, "search", lambda *_: next(searches))
    unused: Any = None
    assert hand.find_with_a_hand(Console(quiet=True), unused, (8, 8))[0] == firmer


def test_the_robot_is_asked_for_until_it_has_an_address() -> None:
    with Robot() as robot, Terminal("init", "--port", "none") as terminal:
        terminal.until("The robot's name or address")
        terminal.answer("nao local", "is not a robot's name or address, such as nao.local")
        terminal.until("The robot's name or address")
        terminal.answer(robot.url.removeprefix("tcp://"), f"trying {robot.url} ...")
        assert robot.url in terminal.until(" doctor -c")
    found = load(FILE).robot
    assert found is not None
    assert found.url == robot.url


def test_a_grid_that_does_not_fit_is_asked_for_again() -> None:
    with FakePort(STREAM, ENCODE, loop=True) as port:
        terminal = Terminal("init", "--port", port.path, "--baud", "115200")
        terminal.until("Rows and columns? [10x10] (as fabric-grid)")
        terminal.answer("8x8", "209 bytes a frame do not fit 8x8 cells", "Rows and columns? [10x10]")
    with terminal:
        # The pad is unplugged here.
        terminal.answer("", f"{port.path} went away: unplugged or switched off?", "The robot's name")


def wandering_then_held(row: int, column: int, held_s: float, wandering_s: float = SECONDS) -> Stream:
    """A fabric pad at rest, under a hand that wanders, and under one that holds a place."""
    wandering = pressed(10, 10, 1023, np.random.default_rng(1))
    y, x = np.mgrid[0:10, 0:10]
    hand = 500 * np.exp(-(((y - row) / 2) ** 2) - ((x - column) / 2) ** 2)
    held = wandering[:1] + np.repeat(hand[None], round(50 * held_s), axis=0)
    moving = wandering[len(wandering) - round(50 * wandering_s) :]
    counts = np.concatenate([wandering[:25], moving, held])[:, 1:9, 1:9].clip(0, 1023).astype(np.uint16)
    return Stream(counts, 20 * np.arange(len(counts)), ())


# The hand of all cases but the first is there before the corner is asked for.
@pytest.mark.parametrize(
    ("row", "column", "turn", "wandering_s"),
    [(1, 1, 0, 1.5), (1, 8, 270, 0.0), (8, 8, 180, 0.0), (8, 1, 90, 0.0)],
)
def test_the_corner_is_where_the_hand_stays(
    row: int, column: int, turn: int, wandering_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hand, "_follows", lambda *_: True)
    pad = FakePort(wandering_then_held(row, column, 4.0, wandering_s), ENCODE)
    with pad as port, open_port(port.path, 115_200) as opened:
        at_rest = listen(opened, 0.5)
        turned = turned_with_a_hand(Console(quiet=True), opened, PRESETS["fabric-grid"], at_rest)
    assert turned == replace(PRESETS["fabric-grid"], turn=turn)


@pytest.mark.slow
def test_all_is_asked_again_until_the_picture_follows() -> None:
    with (
        FakePort(wandering_then_held(1, 1, 4.0), ENCODE, loop=True) as port,
        Terminal("init", "--port", port.path, "--baud", "115200") as terminal,
    ):
        terminal.until("Rows and columns?")
        terminal.answer("", "Does the picture follow it?")
        terminal.answer("n", "Does the picture follow it?")
        terminal.answer("n", "once more: are the rows and columns right?", "Rows and columns?")
        terminal.answer("", "Does the picture follow it?")
        terminal.answer("y", "The robot's name or address")
        terminal.answer("", " doctor -c")
    assert load(FILE).sensor.described == PRESETS["fabric-grid"]
