"""`touchd doctor`: each fault of a pad, a line, a robot or a service is named, with what to do about it."""

from __future__ import annotations

import json
import os
import termios
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import serial
from robots import Robot, every_robot
from sensor_rig import Encode

from daemon import cli
from daemon.commands.doctor import WIDTH
from daemon.config import RobotConfig, SensorSettings, Settings
from daemon.doctor.check import Check
from daemon.doctor.examine import examine
from daemon.doctor.line import check_damage, check_protocol, check_rate
from daemon.doctor.listening import Heard, listen
from daemon.doctor.machine import check_model, check_robot, check_service
from daemon.doctor.pad import (
    check_noise,
    check_orientation,
    check_quiet,
    check_rest,
    check_taxels,
    is_pressed,
)
from daemon.wire import parser_for
from drivers.fake_port import FakePort
from drivers.frame import Counts, Frame
from drivers.line_faults import NO_FAULTS, Faults
from drivers.port import open_port
from drivers.protocol import encode_csv_line, encode_fabric_grid
from drivers.recording import Stream, ideal_clock_ms
from drivers.simulator import simulate

SETTINGS = Settings()


def resting(seconds: float = 8.0) -> Counts:
    """What a sound pad sends while nothing touches it."""
    (recording,) = simulate((("notouch", seconds),), seed=3)
    return np.array(recording.counts)


def heard(
    counts: Counts,
    encode: Encode = encode_fabric_grid,
    rate_hz: float = 54.0,
    faults: Faults = NO_FAULTS,
    speed: float | None = None,
) -> Heard:
    """What is heard of these counts over a pty, by default flat out."""
    clock_ms = np.rint(np.arange(len(counts)) * 1000 / rate_hz).astype(np.int64)
    almost_all_s = (len(counts) - 3) / rate_hz
    with (
        FakePort(Stream(counts, clock_ms, ()), encode, speed=speed, faults=faults) as port,
        open_port(port.path, 512_000) as opened,
    ):
        return listen(opened, parser_for(SETTINGS.sensor), almost_all_s)


@pytest.fixture(scope="module")
def sound() -> Heard:
    return heard(resting())


def the(name: str, checks: Iterator[Check]) -> Check:
    (check,) = [check for check in checks if check.name == name]
    return check


def test_a_sound_pad_passes_every_check_and_the_exit_code_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    counts = resting(4.0)
    with FakePort(Stream(counts, ideal_clock_ms(len(counts)), ()), encode_fabric_grid) as port:
        assert cli.main(["doctor", "--port", port.path, "--seconds", "1.2", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["ok"] is True
    verdicts = {check["name"]: check["verdict"] for check in shown["checks"]}
    assert [name for name, verdict in verdicts.items() if verdict == "ok"] == [
        *("port", "protocol", "line", "rate", "quiet", "rest", "noise", "model", "robot")
    ]
    (rate,) = [check for check in shown["checks"] if check["name"] == "rate"]
    assert rate["figures"]["rate_hz"] == pytest.approx(54, abs=0.3)
    assert rate["figures"]["lost"] == 0


def test_a_port_that_is_not_there_is_something_to_do_in_lines_of_80_columns(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["doctor", "--port", "/dev/ttyNowhere"]) == 1
    shown = capsys.readouterr().out
    assert "to do       port" in shown
    assert "-> plug the pad in, or name its port in sensor.port" in shown
    assert shown.endswith("1 to do\n")
    assert all(len(line) <= WIDTH for line in shown.splitlines())


def test_a_configuration_or_a_time_that_cannot_be_is_a_mistake_in_the_call(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["doctor", "-c", "nowhere.yaml"]) == 2
    assert "nowhere.yaml: cannot be read" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        cli.main(["doctor", "--seconds", "0"])
    assert ended.value.code == 2


def test_a_port_that_the_service_reads_is_told_from_one_that_another_program_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = FakePort(Stream(resting(1.0), ideal_clock_ms(54), ()), encode_fabric_grid)
    settings = Settings(sensor=SensorSettings(port=port.path))
    with port, serial.Serial(port.path, exclusive=True):
        other = the("port", examine(settings, 1.0, print))
        systemd_says("LoadState=loaded\nActiveState=active", tmp_path, monkeypatch)
        service = the("port", examine(settings, 1.0, print))
    assert other.verdict == "to do"
    assert "busy" in other.found
    assert service.verdict == "not checked"
    assert "sudo systemctl stop touchd" in service.advice


def systemd_says(answer: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a systemctl in the way that gives this answer, and fails where it is none."""
    program = folder / "systemctl"
    program.write_text(f"#!/bin/sh\ncat <<'END'\n{answer}\nEND\nexit {0 if answer else 1}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")


def noise(counts: Counts, sensor_ms: int) -> bytes:
    return np.random.default_rng(sensor_ms).bytes(200)


def as_8x8(counts: Counts, sensor_ms: int) -> bytes:
    return encode_fabric_grid(counts, sensor_ms, rows=8, columns=8, crop=0)


def nothing(counts: Counts, sensor_ms: int) -> bytes:
    return b""


@pytest.mark.parametrize(
    ("encode", "found", "advice"),
    [
        (
            as_8x8,
            "looks like fabric-grid 8x8, configured fabric-grid 10x10",
            "sensor.protocol, rows, columns",
        ),
        (encode_csv_line, "looks like csv 10x10", "sensor.protocol, rows, columns"),
        (nothing, "no data", "reset button"),
    ],
)
def test_a_line_without_frames_is_recognised(encode: Encode, found: str, advice: str) -> None:
    check = protocol_of(encode, start_s=0.4)
    assert check.verdict == "to do"
    assert found in check.found
    assert advice in check.advice


def protocol_of(encode: Encode, start_s: float) -> Check:
    counts = resting(60.0)
    port = FakePort(Stream(counts, ideal_clock_ms(len(counts)), ()), encode, speed=10.0)
    with port, open_port(port.path, 512_000) as opened:
        unheard = listen(opened, parser_for(SETTINGS.sensor), 1.0, start_s=start_s)
        return check_protocol(unheard, SETTINGS.sensor, opened)


def test_another_baud_rate_is_found_by_trying() -> None:
    slave: list[str] = []

    def only_at_115200(counts: Counts, sensor_ms: int) -> bytes:
        line = os.open(slave[0], os.O_RDWR | os.O_NOCTTY)
        speed = termios.tcgetattr(line)[5]
        os.close(line)
        return encode_fabric_grid(counts, sensor_ms) if speed == termios.B115200 else noise(counts, sensor_ms)

    counts = resting(60.0)
    with FakePort(Stream(counts, ideal_clock_ms(len(counts)), ()), only_at_115200, speed=4.0) as port:
        slave.append(port.path)
        with open_port(port.path, 512_000) as opened:
            unheard = listen(opened, parser_for(SETTINGS.sensor), 1.0, start_s=0.4)
            check = check_protocol(unheard, SETTINGS.sensor, opened)
    assert check.advice == "set sensor.baud: 115200"


def test_a_pad_unplugged_while_it_is_listened_to_is_told() -> None:
    counts = resting(4.0)
    port = FakePort(Stream(counts, ideal_clock_ms(len(counts)), ()), encode_fabric_grid)
    with port, open_port(port.path, 512_000) as opened:
        first = listen(opened, parser_for(SETTINGS.sensor), 0.3)
        port.stop()
        after = listen(opened, parser_for(SETTINGS.sensor), 0.3)
    assert len(first.frames) > 5
    assert "unplugged" in check_protocol(after, SETTINGS.sensor, opened).found


def test_a_clean_line_is_told_from_one_that_damages_frames(sound: Heard) -> None:
    assert check_damage(sound).verdict == "ok"
    assert check_damage(heard(resting(), faults=Faults(flip_bit_every=100))).verdict == "warning"
    damaged = check_damage(heard(resting(), faults=Faults(flip_bit_every=10)))
    assert damaged.verdict == "to do"
    assert "shorter cable" in damaged.advice


def test_lost_frames_are_counted() -> None:
    check = check_rate(heard(resting(), faults=Faults(drop_frame_every=20)))
    assert check.figures["lost"] == pytest.approx(21, abs=1)


def test_a_clock_that_runs_wrong_is_told_from_a_pad_that_is_slow() -> None:
    frames = [Frame(i, 18 * i, 0.009 * i, np.zeros((8, 8), np.uint16)) for i in range(400)]
    late = [replace(frames[-1], host_s=frames[-1].host_s + 0.3)]
    clock = check_rate(Heard((*frames[:-1], *late), 0, b"", late[0].host_s, ""))
    assert "its clock runs 2.00 times as fast" in clock.found
    assert "milliseconds" in clock.advice
    slow = check_rate(heard(resting(4.0), rate_hz=40.0))
    assert slow.figures["rate_hz"] == pytest.approx(40, abs=0.5)
    assert "54 Hz" in slow.advice


def test_a_sound_pad_at_rest_is_quiet_and_all_its_taxels_are_alive(sound: Heard) -> None:
    checks = [check_quiet(sound, SETTINGS), check_rest(sound, SETTINGS), check_noise(sound)]
    assert [check.verdict for check in [*checks, *check_taxels(sound)]] == ["ok"] * 4


def dead_row(counts: Counts) -> None:
    counts[:, 3] = 0


def stuck_taxel(counts: Counts) -> None:
    counts[:, 2, 4] = 7


def short(counts: Counts) -> None:
    counts[:, :, :3] = 1023


@pytest.mark.parametrize(
    ("damage", "found"),
    [(dead_row, "row 4"), (stuck_taxel, "row 3 column 5"), (short, "a quarter of the pad or more")],
)
def test_broken_taxels_are_named(damage: Callable[[Counts], None], found: str) -> None:
    counts = resting()
    damage(counts)
    troubles = check_taxels(heard(counts))
    assert any(found in trouble.found and trouble.advice for trouble in troubles)
    assert {trouble.verdict for trouble in troubles} == {"to do"}


def test_taxels_are_not_judged_after_too_short_a_time_or_on_a_pad_that_is_silent() -> None:
    assert check_taxels(heard(resting(3.0)))[0].verdict == "not checked"
    assert check_taxels(heard(np.zeros_like(resting())))[0].verdict == "warning"


def test_a_noisy_taxel_and_a_noisy_pad_are_told_apart() -> None:
    rng = np.random.default_rng(1)
    counts = resting()
    counts[:, 6, 1] += rng.integers(0, 40, len(counts)).astype(np.uint16)
    one = check_noise(heard(counts))
    assert "row 7 column 2 is noisy" in one.found
    everywhere = check_noise(heard(counts + rng.integers(0, 40, counts.shape).astype(np.uint16)))
    assert "the whole pad is noisy" in everywhere.found


def test_a_pad_the_wrong_way_up_and_one_under_a_load_are_told_apart() -> None:
    upside_down = check_rest(heard(np.uint16(1023) - resting()), SETTINGS)
    assert upside_down.advice == "set sensor.invert: false"
    counts = resting()
    counts[:, 1, 2] += 200
    assert "something lies on row 2 column 3" in check_rest(heard(counts), SETTINGS).found


def test_a_touch_while_the_pad_should_be_left_alone_is_told() -> None:
    script = (("notouch", 3.0), ("rub", 2.0), ("notouch", 2.0))
    counts = np.concatenate([recording.counts for recording in simulate(script, seed=3)])
    check = check_quiet(heard(counts), SETTINGS)
    assert check.found == "a touch was felt while listening"
    assert "loose wire" in check.advice


@pytest.mark.parametrize(
    ("row", "column", "verdict", "advice"),
    [(0, 1, "ok", ""), (7, 7, "to do", "180"), (0, 7, "to do", "90"), (7, 0, "to do", "90")],
)
def test_the_pressed_corner_tells_how_the_pad_lies(row: int, column: int, verdict: str, advice: str) -> None:
    counts = resting(1.0)
    rest = np.median(counts, axis=0)
    counts[-10:, row, column] += 300
    pressed = heard(counts)
    assert is_pressed(pressed.frames[-1], rest)
    check = check_orientation(pressed, rest)
    assert check.verdict == verdict
    assert advice in check.advice


def test_the_corner_is_asked_for_and_not_pressing_it_is_no_fault() -> None:
    counts = resting(20.0)
    counts[100:, 0, 0] += 300
    asked: list[str] = []
    with FakePort(Stream(counts, ideal_clock_ms(len(counts)), ()), encode_fabric_grid, speed=4.0) as port:
        settings = Settings(sensor=SensorSettings(port=port.path))
        check = the("orientation", examine(settings, 1.2, asked.append, with_press=True))
    assert check.verdict == "ok"
    assert "top left corner" in asked[1]
    untouched = heard(resting(1.0))
    assert check_orientation(untouched, np.median(untouched.counts(), axis=0)).verdict == "not checked"


def test_a_model_that_is_missing_or_does_not_fit_is_told() -> None:
    assert check_model(SETTINGS).verdict == "ok"
    missing = check_model(Settings(model="/nowhere/model.onnx"))
    assert missing.verdict == "to do"
    assert "cannot be read" in missing.found


@every_robot
def test_the_robot_is_asked_for_its_version(make_robot: type[Robot]) -> None:
    with make_robot() as robot:
        check = check_robot(Settings(robot=RobotConfig(url=robot.url)), robot.open_session)
        assert check.verdict == "ok"
        assert "NAOqi 2.8.7.4" in check.found
        robot.kill()
        gone = check_robot(Settings(robot=RobotConfig(url=robot.url)), robot.open_session)
    assert gone.verdict == "to do"
    assert "ping it" in gone.advice


def test_a_robot_with_a_user_but_no_token_is_told_before_it_is_called() -> None:
    check = check_robot(Settings(robot=RobotConfig(url="tcps://nao.local:9503", user="nao")))
    assert check.verdict == "to do"
    assert "token" in check.found


@pytest.mark.parametrize(
    ("answer", "verdict", "found"),
    [
        ("LoadState=not-found", "ok", "no touchd service is installed"),
        (
            "LoadState=loaded\nActiveState=active\nStatusText=54.0 frames/s\nNRestarts=0",
            "ok",
            "54.0 frames/s",
        ),
        ("LoadState=loaded\nActiveState=active\nNRestarts=3", "warning", "restarted 3 times"),
        ("LoadState=loaded\nActiveState=active\nUnitFileState=disabled", "warning", "not started at boot"),
        ("LoadState=loaded\nActiveState=inactive", "warning", "installed, but inactive"),
        ("LoadState=loaded\nActiveState=failed\nResult=exit-code", "to do", "failed (exit-code)"),
        ("", "not checked", "no systemd answers"),
    ],
)
def test_the_state_of_the_service_is_told(
    answer: str, verdict: str, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systemd_says(answer, tmp_path, monkeypatch)
    check = check_service()
    assert check.verdict == verdict
    assert found in check.found
