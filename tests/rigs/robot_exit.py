"""Ends while its link to a robot is in the state named on the command line."""

import logging
import socket
import sys
import time
from typing import Any

from rigs.robots import SAY, Robot, States, reach
from rigs.wait import AT_ONCE_S

from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.settings import Login, RobotSettings


def main(state: str) -> int:
    encrypted = state in ("tls", "wrong-token")
    login = Login("nao" if state == "tls" else "nobody", "s3cret-token") if encrypted else None
    # Nothing may be printed at a clean end, so the link's warnings are off.
    logging.disable()
    mute = socket.create_server(("127.0.0.1", 0))
    with Robot(login=login, say_s=60) as robot:
        url = f"tcp://127.0.0.1:{mute.getsockname()[1]}" if state == "mute" else robot.url
        user: dict[str, Any] = {"user": "nao", "token_env": "ROBOT_TOKEN"} if encrypted else {}
        states = States()
        link = RobotLink(RobotSettings(url=url, **user), states, actions={DEFAULT_PAD: (SAY,)})
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
