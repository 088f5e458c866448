"""`touchd fake-robot`: prints every call to the robot as a line."""

import json
import signal
import socket

from rigs.programs import TOUCHD, Program, ran
from rigs.robots import link_threads, say
from rigs.wait import WITHIN_S

from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.session import RobotSettings


def test_it_prints_its_address_and_every_call() -> None:
    with Program(*TOUCHD, "fake-robot", "--port", "0") as process:
        url = json.loads(process.stdout.readline())["listening"]
        assert url.startswith("tcp://127.0.0.1:")
        link = RobotLink(RobotSettings(url=url), acts=True)
        link.start()
        link.act([say("pat")])
        calls = map(json.loads, process.stdout)
        said = next(call for call in calls if call["method"] == "say")
        assert said["arguments"] == ["pat"]
        link.stop()
        process.send_signal(signal.SIGINT)
        assert process.wait(WITHIN_S) == 0
    assert link_threads() == []


def test_a_port_in_use_is_reported_in_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        done = ran([*TOUCHD, "fake-robot", "--port", str(taken.getsockname()[1])])
    assert done.returncode == 2
    assert done.stderr.startswith("touchd: cannot listen on port")
    assert len(done.stderr.splitlines()) == 1
