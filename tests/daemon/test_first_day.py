"""The first day with touchd: help, mistakes, paths, commands to paste."""

import importlib.util
import os
import shlex
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rigs.expectations import DEMO, GESTURES
from rigs.patient_port import playing
from rigs.programs import TOUCHD, WITHOUT_EXTRAS, Program, ran
from rigs.terminal import Terminal
from rigs.wait import WITHIN_S

from touchd.daemon import commands
from touchd.daemon.app import cli
from touchd.daemon.app.config import ConfigError, SensorSettings, Settings, load
from touchd.daemon.app.parts import check_pad
from touchd.daemon.commands.settings import find_settings
from touchd.daemon.doctor.check import Sample
from touchd.daemon.doctor.line import check_rate
from touchd.drivers.frame import Frame
from touchd.drivers.installed import TORCH_ON_CPU, how_to_install, program_name

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "daemon/touchd.example.yaml"


def python(code: str) -> subprocess.CompletedProcess[str]:
    return ran([sys.executable, "-c", WITHOUT_EXTRAS + code])


def test_every_command_prints_help_without_any_extra() -> None:
    done = python(
        "for command in cli.COMMANDS:\n"
        "    try: cli.main([command, '--help'])\n"
        "    except SystemExit as ended: assert ended.code == 0\n"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("usage: touchd ") == len(cli.COMMANDS)


def test_a_missing_extra_is_named_with_what_installs_it() -> None:
    needed = {"plot": "plot", "train --extra .": "train", "demo --live": "live", "run --live": "live"}
    done = python(
        f"for command in {list(needed)}:\n"
        "    assert cli.main(command.split()) == 2\n"
        "    sys.stderr.flush()\n"
        "    print(file=sys.stderr)\n"
    )
    assert done.returncode == 0, done.stderr
    said = done.stderr.split("\n\n")
    assert said.pop() == ""
    for line, extra in zip(said, needed.values(), strict=True):
        assert "\n" not in line
        assert how_to_install(extra) in line


@pytest.mark.parametrize("pip", [None, "pip"])
def test_torch_for_learning_is_the_one_for_the_processor(
    pip: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: pip)
    tool = f"{sys.executable} -m pip install" if pip else f"uv pip install --python={sys.executable}"
    torch, others = how_to_install("train").split(" && ")
    assert torch.startswith(f"{tool} --index-url={TORCH_ON_CPU} 'torch>=")
    # Torch's own index has nothing else.
    assert others.startswith(f"{tool} ")
    assert "torch>=" not in others


def test_the_services_own_python_needs_sudo(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    assert how_to_install("mqtt").startswith(f"sudo {sys.executable} -m pip install ")


@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        ("--help >&-", 0, ""),
        ("convert nowhere -o x.csv >&-", 2, "journal nowhere: cannot be read"),
        ("clasify 2>&-", 2, ""),
        ("version <&-", 0, ""),
        ("--help >/dev/full", 2, "standard output: cannot be written (No space left on device)"),
        ("--help | true", 0, ""),
        (f"classify {GESTURES} --gesture rub | true", 0, ""),
    ],
)
def test_closed_or_full_streams_cause_no_internal_error(
    monkeypatch: pytest.MonkeyPatch, command: str, code: int, said: str
) -> None:
    # Unbuffered output fails as it is written, not at the end.
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    done = ran(["bash", "-o", "pipefail", "-c", f"{sys.executable} -m touchd.daemon {command}"])
    assert (done.returncode, said in done.stderr) == (code, True)
    assert len(done.stderr.splitlines()) == bool(said)


def test_the_printed_name_runs_this_program(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", os.defpath)
    for folder in (tmp_path, ROOT):
        monkeypatch.chdir(folder)
        done = ran([*shlex.split(program_name()), "--version"], check=True)
        assert done.stdout.startswith("touchd 0.")


@pytest.fixture
def homes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """The paths of configurations here, in the user's folder and in the service's."""
    folders = {
        "here": tmp_path / "here",
        "user": tmp_path / "user/touchd",
        "service": tmp_path / "etc/touchd",
    }
    for folder in folders.values():
        folder.mkdir(parents=True)
    monkeypatch.chdir(folders["here"])
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "user"))
    monkeypatch.setattr(commands.settings, "SERVICE_FOLDER", folders["service"])
    return {name: folder / "touchd.yaml" for name, folder in folders.items()}


def test_the_nearest_configuration_is_taken(homes: dict[str, Path]) -> None:
    assert find_settings(None).file is None
    for place in ("service", "user", "here"):
        homes[place].write_text(f"sensor: {{port: {place}}}")
        found = find_settings(None)
        assert found.settings.sensor.port == place
        assert str(found) == f"settings: {homes[place]}"
    homes["here"].write_text("sensr: {}")
    with pytest.raises(ConfigError, match="unknown setting"):
        find_settings(None)
    assert find_settings(homes["user"]).settings.sensor.port == "user"


@pytest.mark.parametrize("what", ["file", "folder"])
def test_a_configuration_that_only_root_reads_is_named(
    homes: dict[str, Path], monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    # The files of a folder that is closed cannot be seen.
    if what == "file":
        homes["service"].write_text("sensor: {port: service}")
    open_folder = homes["service"].parent if what == "file" else None
    monkeypatch.setattr(os, "access", lambda path, *_, **__: path == open_folder)
    said = f"settings: the defaults; {homes['service']} can be read only with sudo"
    assert str(find_settings(None)) == said


def test_commands_say_which_configuration_they_found(
    homes: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    homes["user"].write_text("sensor: {port: spy://}")
    assert cli.main(["doctor", "--seconds", "1"]) == 1
    assert cli.main(["record", "lab", "--participant=a", "--pad=x"]) == 2
    said = capsys.readouterr()
    assert said.err.count(f"settings: {homes['user']}\n") == 2
    assert "spy" in said.out


def test_the_printed_example_is_a_configuration(
    homes: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["config"]) == 0
    homes["here"].write_text(capsys.readouterr().out)
    assert find_settings(None).settings == load(EXAMPLE)


def test_pages_are_listed_and_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["docs"]) == 0
    assert "pads" in capsys.readouterr().out.split()
    assert cli.main(["docs", "pads"]) == 0
    assert capsys.readouterr().out == (ROOT / "docs/pads.md").read_text()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_configuration_without_read_permission_asks_for_sudo(tmp_path: Path) -> None:
    path = tmp_path / "touchd.yaml"
    path.touch(mode=0o000)
    with pytest.raises(Exception, match="put sudo before the command"):
        load(path)


def test_a_pad_without_permission_or_busy_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    check_pad(Settings(sensor=SensorSettings(port="/dev/null")))


def test_a_clock_that_restarts_does_not_report_a_broken_pad() -> None:
    clock_ms = [*range(5000, 9000, 18), *range(0, 4000, 19)]
    counts = np.zeros((8, 8), np.uint16)
    frames = tuple(Frame(ms, n / 54, counts) for n, ms in enumerate(clock_ms))
    checked = check_rate(Sample(frames, 0, b"", len(frames) / 54))
    assert checked.verdict == "ok", checked


def test_classify_speaks_to_a_person_in_a_terminal() -> None:
    with Terminal("classify") as terminal:
        terminal.until("touch 1 begins")
        terminal.until("touch 6 ends: still hand")


def test_run_speaks_to_people_in_terminals_and_json_on_request() -> None:
    with playing(DEMO, 8.0) as port, Terminal("run", "--port", port.path) as terminal:
        terminal.until("pad up")
        terminal.until("touch 1 ends: pat")
    with Terminal("run", "--json", "--port", "/dev/nowhere") as terminal:
        terminal.until('{"type":"sensor"')


@pytest.mark.parametrize("number", [pytest.param(signal.SIGTERM, marks=pytest.mark.slow), signal.SIGHUP])
def test_a_terminated_demo_leaves_nothing_behind(
    tmp_path: Path, number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    # A suite that runs under nohup ignores the signal, and so would the demo.
    default_signal = partial(signal.signal, number, signal.SIG_DFL)
    with Program(*TOUCHD, "demo", preexec_fn=default_signal) as process:
        process.stdout.readline()
        assert list(tmp_path.iterdir())
        process.send_signal(number)
        assert process.wait(WITHIN_S) == 0
    assert list(tmp_path.iterdir()) == []
