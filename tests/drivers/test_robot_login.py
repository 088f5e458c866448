"""The token goes to no other robot; a token or certificate that was renewed is read again."""

from pathlib import Path

import pytest
import trustme
from rigs.robots import LOGIN, Robot, hears, linked, login_in
from rigs.wait import wait_for

from touchd.daemon.app.config import Settings
from touchd.daemon.doctor.machine import certificate_at, check_robot
from touchd.drivers.robot.login import Login
from touchd.drivers.robot.session import RobotSettings


def saved(authority: trustme.CA, folder: Path) -> str:
    file = folder / "robot.pem"
    authority.cert_pem.write_to_path(str(file))
    return str(file)


@pytest.mark.parametrize("form", ["file", "fingerprint", "fingerprint of openssl"])
def test_a_robot_with_its_certificate_gets_the_token(form: str, tmp_path: Path) -> None:
    with Robot(login=LOGIN) as robot:
        shown = certificate_at(robot.url)
        assert shown is not None
        pairs = shown.removeprefix("sha256:").upper()
        pinned = {
            "file": saved(robot.authority, tmp_path),
            "fingerprint": shown,
            "fingerprint of openssl": "sha256:" + ":".join(pairs[at : at + 2] for at in range(0, 64, 2)),
        }
        with linked(robot, certificate=pinned[form], **login_in(tmp_path)) as (link, states):
            states.wait_for("up")
            hears(robot, link)


@pytest.mark.parametrize("form", ["file", "fingerprint"])
def test_a_robot_with_another_certificate_gets_no_token(form: str, tmp_path: Path) -> None:
    pinned = saved(trustme.CA(), tmp_path) if form == "file" else f"sha256:{'ab' * 32}"
    with Robot(login=LOGIN) as robot:
        with linked(robot, certificate=pinned, **login_in(tmp_path)) as (_, states):
            reason = states.wait_for("down")
        assert "not the robot of robot.certificate" in reason
        assert form == "file" or str(certificate_at(robot.url)) in reason
        assert robot.gate is not None
        assert robot.gate.first_messages == []


def test_a_renewed_token_is_read_at_the_next_connection(tmp_path: Path) -> None:
    with Robot(login=LOGIN) as robot, linked(robot, **login_in(tmp_path)) as (link, states):
        states.wait_for("up")
        assert robot.gate is not None
        robot._login = renewed = Login(LOGIN.user, "an0ther")
        robot.kill()
        login_in(tmp_path, renewed)
        robot.start()
        states.wait_for("up", "down", "up")
        hears(robot, link)


def test_a_renewed_certificate_is_read_at_the_next_connection(tmp_path: Path) -> None:
    with (
        Robot(login=LOGIN) as robot,
        linked(robot, certificate=saved(robot.authority, tmp_path), **login_in(tmp_path)) as (link, states),
    ):
        states.wait_for("up")
        robot.authority = trustme.CA()
        robot.kill()
        saved(robot.authority, tmp_path)
        robot.start()
        states.wait_for("up", "down", "up")
        hears(robot, link)


def test_a_token_file_that_is_gone_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with Robot(login=LOGIN) as robot, linked(robot, **login_in(tmp_path)) as (_, states):
        states.wait_for("up")
        (tmp_path / "token").unlink()
        robot.kill()
        robot.start()
        wait_for(lambda: "robot.token_file" in caplog.text)


def test_the_doctor_shows_the_certificate_to_pin(tmp_path: Path) -> None:
    with Robot(login=LOGIN) as robot:
        shown = certificate_at(robot.url)
        pin = f"if it is your robot, set robot.certificate: {shown}"
        without = check_robot(Settings(robot=RobotSettings(url=robot.url)))
        assert (without.verdict, without.advice.endswith(pin)) == ("to do", True)
        trusted = check_robot(Settings(robot=RobotSettings(url=robot.url, **login_in(tmp_path))))
        assert (trusted.verdict, trusted.advice) == ("ok", pin)
        pinned = RobotSettings(url=robot.url, certificate=shown, **login_in(tmp_path))
        assert check_robot(Settings(robot=pinned)).advice == ""
