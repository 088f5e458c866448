"""`touchd doctor`: one line for each check, an exit code, and the checks of model, robot and service."""

import math
import re
from pathlib import Path

import pytest
import serial
from rigs.doctor_rig import SETTINGS, pad_of, resting, systemd_says, the
from rigs.formats import encode_csv_line
from rigs.robots import Robot

from touchd.daemon.app import cli
from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.doctor.examine import examine
from touchd.daemon.doctor.machine import check_model, check_robot, check_service
from touchd.drivers.robot.session import RobotSettings
from touchd.drivers.search.search import Finding

ACTIVE = "LoadState=loaded\nActiveState=active\n"


@pytest.mark.parametrize(("told", "searched"), [(["--grid", "12x9"], [(12, 9)]), ([], [(10, 10), None])])
def test_the_doctor_searches_with_the_grid_that_was_told(
    monkeypatch: pytest.MonkeyPatch, told: list[str], searched: list[tuple[int, int] | None]
) -> None:
    grids: list[tuple[int, int] | None] = []

    def find(say: object, opened: object, each: tuple[tuple[int, int] | None, ...]) -> Finding:
        grids.extend(each)
        return Finding(None, "press it", "text")

    monkeypatch.setattr("touchd.daemon.doctor.examine.find_without_asking", find)
    with pad_of(resting(30.0), encode_csv_line) as port:
        assert cli.main(["doctor", "--port", port.path, "--seconds", "1", *told]) == 1
    assert grids == searched


def test_a_sound_pad_passes_every_check(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # On a busy machine the doctor would warn, correctly, of slow answers.
    monkeypatch.setattr("touchd.daemon.doctor.machine.SLOW_ANSWER_MS", math.inf)
    with pad_of(resting(4.0)) as port:
        assert cli.main(["doctor", "--port", port.path, "--seconds", "1.2"]) == 0
    shown = capsys.readouterr().out
    assert re.findall(r"^ok +(\w+)", shown, re.MULTILINE) == [
        *("port", "protocol", "line", "rate", "quiet", "rest", "noise", "model", "robot")
    ]
    assert re.search(r"rate +5[34]\.\d frames/s, jitter ", shown)
    assert shown.endswith("nothing to do\n")


def test_a_missing_port_says_what_to_do_within_80_columns(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["doctor", "--port", "/dev/ttyNowhere"]) == 1
    shown = capsys.readouterr().out
    assert "to do       port" in shown
    assert "-> plug the pad in, or name its port in sensor.port" in shown
    assert shown.endswith("1 to do\n")
    assert all(len(line) <= 80 for line in shown.splitlines())


def test_a_pad_unplugged_during_the_checks_is_reported_before_the_others() -> None:
    with pad_of(resting(4.0)) as port:
        checks = examine(Settings(sensor=SensorSettings(port=port.path)), 60.0, lambda line: None)
        assert next(checks).name == "port"
        port.stop()
        gone, model, *_ = checks
    assert (gone.verdict, model.name) == ("to do", "model")
    assert "unplugged" in gone.found
    assert gone.advice.startswith("plug the pad in")


def test_a_port_busy_with_the_service_is_recognised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = pad_of(resting(1.0))
    settings = Settings(sensor=SensorSettings(port=port.path))
    with port, serial.Serial(port.path, exclusive=True):
        other = the("port", examine(settings, 1.0, print))
        systemd_says(ACTIVE, tmp_path, monkeypatch)
        service = the("port", examine(settings, 1.0, print))
    assert other.verdict == "to do"
    assert "is open in another program" in other.found
    assert service.verdict == "not checked"
    assert "sudo systemctl stop touchd" in service.advice


def test_a_missing_slow_or_unfit_model_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    for slow_ms, verdict in ((math.inf, "ok"), (0.0, "warning")):
        monkeypatch.setattr("touchd.daemon.doctor.machine.SLOW_ANSWER_MS", slow_ms)
        assert check_model(SETTINGS).verdict == verdict
    homeless = check_model(Settings(model="~nosuch/model.onnx"))
    assert "~nosuch/model.onnx: unknown home" in homeless.found
    missing = check_model(Settings(model="/nowhere/model.onnx"))
    assert missing.verdict == "to do"
    assert "cannot be read" in missing.found


def test_the_robot_is_asked_for_its_version() -> None:
    with Robot() as robot:
        check = check_robot(Settings(robot=RobotSettings(url=robot.url)))
        assert check.verdict == "ok"
        assert "NAOqi 2.8.7.4" in check.found
        robot.kill()
        gone = check_robot(Settings(robot=RobotSettings(url=robot.url)))
    assert gone.verdict == "to do"
    assert "ping it" in gone.advice


def test_a_token_that_cannot_be_read_is_reported() -> None:
    robot = RobotSettings(url="tcps://127.0.0.1:9", user="nao", token_file="/no/such")
    check = check_robot(Settings(robot=robot))
    assert check.verdict == "to do"
    assert "robot.token_file /no/such cannot be read" in check.found


@pytest.mark.parametrize(
    ("answer", "verdict", "found"),
    [
        ("LoadState=not-found", "ok", "no touchd service is installed"),
        (ACTIVE, "ok", "runs"),
        ("LoadState=loaded\nActiveState=inactive", "warning", "installed, but inactive"),
        ("LoadState=loaded\nActiveState=failed\nResult=exit-code", "to do", "failed (exit-code)"),
        ("", "not checked", "no systemd answers"),
    ],
)
def test_the_state_of_the_service_is_reported(
    answer: str, verdict: str, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systemd_says(answer, tmp_path, monkeypatch)
    check = check_service()
    assert check.verdict == verdict
    assert found in check.found
