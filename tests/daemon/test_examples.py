"""The examples in docs/examples work."""

import os
import re
import signal
import sys
from pathlib import Path

import pytest
from rigs.expectations import DEMO
from rigs.patient_port import playing
from rigs.programs import Program, ran
from rigs.robots import Robot, linked, message, needs_qi
from rigs.sockets import free_port
from rigs.wait import WITHIN_S, wait_for

EXAMPLES = Path(__file__).parents[2] / "docs/examples"


@needs_qi
def test_the_python_example_answers_a_stroke_but_no_earlier_touch() -> None:
    with Robot() as robot:
        with linked(robot) as (link, states):
            states.wait_for("up")
            link.put(*message("stroke", touch=1))
            wait_for(lambda: len(robot.calls.raised("TouchGesture/Detail")) == 1)
        with Program(sys.executable, EXAMPLES / "react_to_touch.py", robot.url) as example:
            assert example.stdout.readline() == f"{robot.url}: waiting for touches\n"
            with linked(robot) as (link, states):
                states.wait_for("up")
                # A restarted daemon counts its messages from 1 again.
                link.put(*message("stroke", touch=1))
                assert example.stdout.readline() == "touch 1: stroke (81%, early)\n"
                wait_for(lambda: robot.calls.said() == ["That is nice."])
            example.kill()


def test_the_python_example_without_a_robot_shows_its_usage() -> None:
    done = ran([sys.executable, EXAMPLES / "react_to_touch.py"])
    assert done.returncode == 1
    assert done.stderr.startswith("usage: python react_to_touch.py ADDRESS")


@needs_qi
def test_the_python_example_says_in_a_line_why_it_ends() -> None:
    missing = ran([sys.executable, EXAMPLES / "react_to_touch.py", f"tcp://127.0.0.1:{free_port()}"])
    assert "is the robot on" in missing.stderr
    assert len(missing.stderr.splitlines()) == 1
    with Robot() as robot, linked(robot) as (link, states):
        states.wait_for("up")
        with Program(sys.executable, EXAMPLES / "react_to_touch.py", robot.url) as example:
            example.stdout.readline()
            link.put(*message("pat", touch=3))
            assert example.stdout.readline().startswith("touch 3: pat")
            example.send_signal(signal.SIGINT)
            assert example.wait(WITHIN_S) == 0


def test_the_event_iterator_follows_a_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    with playing(DEMO, 8.0) as port:
        options = ("-c", os.devnull, "--port", port.path)
        with Program(sys.executable, EXAMPLES / "follow_events.py", *options) as example:
            assert re.fullmatch(r"touch 1: pat \(\d+%\)\n", example.stdout.readline())
            example.send_signal(signal.SIGTERM)


@pytest.mark.parametrize("python", [sys.executable, sys._base_executable])  # type: ignore[attr-defined]
def test_the_event_iterator_needs_no_path_in_a_clone(python: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    done = ran([python, EXAMPLES / "follow_events.py", "-c", "/nowhere.yaml"])
    assert done.returncode == 2
    assert done.stderr.startswith("touchd: /nowhere.yaml: cannot be read")
    assert len(done.stderr.splitlines()) == 1


def test_the_event_iterator_without_touchd_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    copy = tmp_path / "a/b/follow_events.py"
    copy.parent.mkdir(parents=True)
    copy.write_bytes((EXAMPLES / "follow_events.py").read_bytes())
    done = ran([sys._base_executable, copy])  # type: ignore[attr-defined]
    assert done.returncode == 1
    assert done.stderr.startswith("touchd is neither on the PATH nor in .venv")


def test_the_choregraphe_box_is_python_that_a_robot_runs() -> None:
    # Robots have Python 2.7: neither annotations nor f-strings.
    text = (EXAMPLES / "choregraphe_box.py").read_text()
    compile(text, "box", "exec")
    assert "->" not in text
    assert 'f"' not in text
