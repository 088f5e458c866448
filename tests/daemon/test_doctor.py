"""`touchd doctor`: one line for each check, an exit code, and the checks of model and robot."""

import math
import re

import pytest
import serial
from rigs.doctor_rig import SETTINGS, pad_of, resting
from rigs.formats import encode_csv_line
from rigs.robots import Robot

from touchd.daemon.app import cli
from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.doctor.examine import examine
from touchd.daemon.doctor.machine import check_model, check_robot
from touchd.drivers.robot.session import RobotSettings
from touchd.drivers.search.search import Finding


@pytest.mark.parametrize(("told", "searched"), [(["--grid", "12x9"], [(12, 9)]), ([], [(10, 10), None])])
def test_the_doctor_searches_with_the_given_grid(
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


def test_a_pad_unplugged_during_the_checks_is_reported_first() -> None:
    with pad_of(resting(4.0)) as port:
        checks = examine(Settings(sensor=SensorSettings(port=port.path)), 60.0, lambda line: None)
        assert next(checks).name == "port"
        port.stop()
        gone, model, *_ = checks
    assert (gone.verdict, model.name) == ("to do", "model")
    assert "unplugged" in gone.found
    assert gone.advice.startswith("plug the pad in")


def test_a_busy_port_says_how_the_service_ends() -> None:
    port = pad_of(resting(1.0))
    with port, serial.Serial(port.path, exclusive=True):
        check = next(examine(Settings(sensor=SensorSettings(port=port.path)), 1.0, print))
    assert (check.name, check.verdict) == ("port", "to do")
    assert "is open in another program" in check.found
    assert "sudo systemctl stop touchd" in check.advice


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
        robot.stop()
        gone = check_robot(Settings(robot=RobotSettings(url=robot.url)))
    assert gone.verdict == "to do"
    assert "ping it" in gone.advice


def test_a_token_that_cannot_be_read_is_reported() -> None:
    robot = RobotSettings(url="tcps://127.0.0.1:9", user="nao", token_file="/no/such")
    check = check_robot(Settings(robot=robot))
    assert check.verdict == "to do"
    assert "robot.token_file /no/such cannot be read" in check.found
