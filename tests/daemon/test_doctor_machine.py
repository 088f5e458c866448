"""The doctor's checks of model, robot and service."""

import math
from pathlib import Path

import pytest
from rigs.doctor_rig import SETTINGS, systemd_says
from rigs.robots import Robot

from daemon.config import Settings
from daemon.doctor.machine import check_model, check_robot, check_service
from drivers.robot.settings import RobotSettings


def test_a_missing_slow_or_unfit_model_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    for slow_ms, verdict in ((math.inf, "ok"), (0.0, "warning")):
        monkeypatch.setattr("daemon.doctor.machine.SLOW_ANSWER_MS", slow_ms)
        assert check_model(SETTINGS).verdict == verdict
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


def test_a_robot_user_without_a_token_is_reported() -> None:
    check = check_robot(Settings(robot=RobotSettings(url="tcps://nao.local:9503", user="nao")))
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
def test_the_state_of_the_service_is_reported(
    answer: str, verdict: str, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systemd_says(answer, tmp_path, monkeypatch)
    check = check_service()
    assert check.verdict == verdict
    assert found in check.found
