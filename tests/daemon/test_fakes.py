"""The fake pad, which every command reads as typed in docs/install.md, and the fake robot."""

import json
import re
import shlex
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from rigs.programs import TOUCHD, Program, ran
from rigs.robots import link_threads, say
from rigs.terminal import Terminal
from rigs.wait import WITHIN_S

from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.session import RobotSettings

PAGE = (Path(__file__).parents[2] / "docs/install.md").read_text()
SECTION = PAGE.partition("## Without a pad")[2].partition("## ")[0]
TYPED = re.findall(r"^touchd (.*?) *(?:#.*)?$", SECTION, re.M)


@pytest.fixture
def pad(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The path of a fake pad, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with Program(*TOUCHD, *shlex.split(TYPED[0])) as program:
        yield next(line.split()[1] for line in program.stdout if line.startswith("pad: "))
        program.send_signal(signal.SIGINT)
        assert program.wait(WITHIN_S) == 0


def typed(command: str, pad: str = "") -> Terminal:
    """Run a command of the page in a terminal."""
    (line,) = [line for line in TYPED if line.split()[0] == command]
    return Terminal(*shlex.split(line.replace("PATH", pad)))


def init(pad: str) -> None:
    with typed("init", pad) as terminal:
        # A busy machine needs longer to find the pad, and to prove the grid.
        terminal.until_one("Rows and columns?", within_s=WITHIN_S)
        terminal.answer("")
        terminal.until_one("Touch the corner that should be top left", within_s=WITHIN_S)
        # The simulated hand does not always press a corner firmly.
        follows = "Does the picture follow it? [Y/n]"
        if terminal.until_one(follows, "no corner was touched") == follows:
            terminal.answer("y")
        terminal.until("(Enter: no robot): ")
        terminal.answer("", "pad: fabric-grid", "wrote touchd.yaml")
        assert terminal.process.wait(WITHIN_S) == 0


def test_commands_run_as_typed_on_a_fake_pad(pad: str) -> None:
    assert [line.split()[0] for line in TYPED] == ["fake-pad", "init", "doctor", "record", "teach", "run"]
    # As init writes it; proving the pad takes half a minute.
    Path("touchd.yaml").write_text(f"sensor: {{port: {pad}}}\njournal: {{}}\n")
    with typed("record") as terminal:
        terminal.until("Who touches the pad?")
    with typed("run") as terminal:
        terminal.until(f"settings: {Path.cwd() / 'touchd.yaml'}; journal: {Path.cwd()}/state/")
        terminal.until("touch 1 ends: ")


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_init_and_doctor_run_as_typed_on_a_fake_pad(pad: str) -> None:
    init(pad)
    with typed("doctor") as terminal:
        terminal.until("fabric-grid 10x10")
        terminal.until("as configured")
        terminal.until("frames/s")
        terminal.until("to do")
        assert terminal.process.wait(WITHIN_S) == 1


def test_the_printed_command_reads_a_pad_of_another_format(tmp_path: Path) -> None:
    file = tmp_path / "other pad.yaml"
    file.write_text("sensor: {format: velostat}")
    with Program(*TOUCHD, "fake-pad", "-c", str(file)) as program:
        command = next(line for line in program.stdout if line.startswith("read it with: "))
        arguments = shlex.split(command.partition(" run ")[2])
        with Program(*TOUCHD, "run", "--json", *arguments) as daemon:
            assert json.loads(daemon.stdout.readline())["state"] == "up"
            daemon.kill()
        program.kill()


def test_the_fake_robot_prints_its_address_and_every_call() -> None:
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


def test_a_robots_port_in_use_is_reported_in_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        done = ran([*TOUCHD, "fake-robot", "--port", str(taken.getsockname()[1])])
    assert done.returncode == 2
    assert done.stderr.startswith("touchd: cannot listen on port")
    assert len(done.stderr.splitlines()) == 1
