"""Ends while its link to a robot is in the state named on the command line."""

import logging
import socket
import sys
import tempfile
import time
from pathlib import Path

from rigs.login_gate import Login
from rigs.robots import Robot, States, login_in, reach
from rigs.wait import AT_ONCE_S

from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.session import RobotSettings


def main(state: str) -> int:
    encrypted = state in ("tls", "wrong-token")
    login = Login("nao" if state == "tls" else "nobody", "s3cret-token") if encrypted else None
    # Nothing may be printed at a clean end, so the link's warnings are off.
    logging.disable()
    mute = socket.create_server(("127.0.0.1", 0))
    with tempfile.TemporaryDirectory() as folder, Robot(login=login, say_s=60) as robot:
        url = f"tcp://127.0.0.1:{mute.getsockname()[1]}" if state == "mute" else robot.url
        user = login_in(Path(folder)) if encrypted else {}
        states = States()
        link = RobotLink(RobotSettings(url=url, **user), states, acts=True)
        if state == "refused":
            robot.kill()
        link.start()
        reach(state, robot, link, states)
        started_s = time.monotonic()
        if state == "forgotten":
            raise SystemExit(0)
        link.stop()
        return 0 if time.monotonic() - started_s < AT_ONCE_S else 3


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
