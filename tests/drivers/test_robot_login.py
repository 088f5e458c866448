"""The token goes to no other robot; a token that was renewed is read again."""

from pathlib import Path

import pytest
from rigs.login_gate import Login
from rigs.robots import LOGIN, Robot, hears, linked, login_in
from rigs.wait import wait_for

from touchd.daemon.app.config import Settings
from touchd.daemon.doctor.machine import certificate_at, check_robot
from touchd.drivers.robot.session import RobotSettings


def test_only_a_robot_with_the_pinned_certificate_gets_the_token(tmp_path: Path) -> None:
    with Robot(login=LOGIN) as robot:
        shown = certificate_at(robot.url)
        assert shown is not None
        digits = shown.removeprefix("sha256:")
        pairs = ":".join(digits[at : at + 2] for at in range(0, 64, 2))
        login = login_in(tmp_path)
        with linked(robot, **login | {"certificate": f"sha256:{'ab' * 32}"}) as (_, states):
            reason = states.wait_for("down")
        assert f"not the robot of robot.certificate: this one's is {shown}" in reason
        assert robot.gate is not None
        assert robot.gate.first_messages == []
        for form in (shown, f"SHA256:{pairs.upper()}"):
            with linked(robot, **login | {"certificate": form}) as (link, states):
                states.wait_for("up")
                hears(robot, link, form)


def test_a_renewed_token_is_read_at_the_next_connection(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with Robot(login=LOGIN) as robot, linked(robot, **login_in(tmp_path)) as (link, states):
        states.wait_for("up")
        (tmp_path / "token").unlink()
        robot._login = renewed = Login(LOGIN.user, "an0ther")
        robot.kill()
        robot.start()
        wait_for(lambda: "robot.token_file" in caplog.text)
        login_in(tmp_path, renewed)
        states.wait_for("up", "down", "up")
        hears(robot, link)


def test_the_doctor_shows_the_certificate_to_pin(tmp_path: Path) -> None:
    with Robot(login=LOGIN) as robot:
        shown = certificate_at(robot.url)
        pin = f"if it is your robot, set robot.certificate: {shown}"
        without = check_robot(Settings(robot=RobotSettings(url=robot.url)))
        assert (without.verdict, without.advice.endswith(pin)) == ("to do", True)
        trusted = check_robot(Settings(robot=RobotSettings(url=robot.url, **login_in(tmp_path))))
        assert (trusted.verdict, trusted.advice) == ("ok", pin)
        pinned = RobotSettings(url=robot.url, **login_in(tmp_path) | {"certificate": shown})
        assert check_robot(Settings(robot=pinned)).advice == ""
