"""`make install` puts the service in place, an upgrade keeps its configuration, `make uninstall` ends it."""

import os
import platform
import re
import shlex
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from rigs.expectations import DEMO
from rigs.programs import ran

from touchd.daemon.app.cli import COMMANDS
from touchd.daemon.app.config import Settings, load
from touchd.drivers.installed import how_to_install

ROOT = Path(__file__).parents[2]
NOT_INSTALLED = tuple(ROOT / "model" / name for name in ("training", "studies"))
PACKAGES = [
    path
    for floor in ("daemon", "drivers", "model")
    for path in (ROOT / floor).rglob("__init__.py")
    if not any(path.is_relative_to(folder) for folder in NOT_INSTALLED)
]
EXAMPLE = ROOT / "daemon/touchd.example.yaml"
CONFIGURATION = "etc/touchd/touchd.yaml"
INSTALLED = {
    "etc/systemd/system/touchd.service",
    "etc/systemd/system/touchd@.service",
    "etc/sysusers.d/touchd.conf",
    "etc/tmpfiles.d/touchd.conf",
    "etc/touchd/touchd.example.yaml",
    CONFIGURATION,
    "etc/udev/rules.d/99-touchd.rules",
}
COMMAND = "usr/local/bin/touchd"
INSTALLED_EXTRAS = ("nao", "live", "mqtt", "lsl", "ros2", "rosbridge", "mcap")

Make = Callable[..., str]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Runs make with tmp_path as DESTDIR; returns what it prints. fails: what it must do."""

    def make(*arguments: str, source: Path = ROOT, fails: bool = False) -> str:
        done = ran(["make", "-C", str(source), "--no-print-directory", *arguments, f"DESTDIR={tmp_path}"])
        assert (done.returncode != 0) == fails, done.stdout + done.stderr
        return done.stdout

    return make


def files_in(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}


def test_every_file_of_the_service_is_put_in_place(make: Make, tmp_path: Path) -> None:
    assert "sudo systemctl enable --now touchd" in make("install-files")
    assert files_in(tmp_path) == {*INSTALLED, COMMAND}
    assert (tmp_path / COMMAND).readlink() == Path("/opt/touchd/bin/touchd")
    assert stat.S_IMODE((tmp_path / CONFIGURATION).stat().st_mode) == 0o640
    assert isinstance(load(tmp_path / CONFIGURATION), Settings)


def test_an_upgrade_keeps_the_configuration_and_renews_the_rest(make: Make, tmp_path: Path) -> None:
    make("install-files")
    unit = (tmp_path / "etc/systemd/system/touchd.service").read_text()
    for path in INSTALLED:
        (tmp_path / path).write_text("mine")
    make("install-files")
    assert (tmp_path / CONFIGURATION).read_text() == "mine"
    assert (tmp_path / "etc/systemd/system/touchd.service").read_text() == unit
    assert "mine" not in {(tmp_path / path).read_text() for path in INSTALLED - {CONFIGURATION}}


def test_the_unit_runs_the_program_where_it_was_installed(make: Make, tmp_path: Path) -> None:
    make("install-files", "PREFIX=/srv/lab")
    unit = (tmp_path / "etc/systemd/system/touchd.service").read_text()
    assert "ExecStart=/srv/lab/touchd/bin/touchd run -c /etc/touchd/touchd.yaml" in unit
    assert "/opt" not in unit


def test_uninstalling_leaves_the_configuration_and_nothing_else(make: Make, tmp_path: Path) -> None:
    make("install-files")
    program = tmp_path / "opt/touchd"
    program.mkdir(parents=True)
    (program / "pyvenv.cfg").write_text("")
    make("uninstall")
    make("uninstall")
    assert files_in(tmp_path) == {CONFIGURATION}
    assert not program.exists()


def test_a_foreign_touchd_command_is_kept(make: Make, tmp_path: Path) -> None:
    command = tmp_path / COMMAND
    command.parent.mkdir(parents=True)
    command.write_text("mine")
    assert "left as it is" in make("install-files")
    make("uninstall")
    assert command.read_text() == "mine"


def test_a_package_installs_into_the_packages_folders(make: Make, tmp_path: Path) -> None:
    make("install-files", "SYSTEM=/usr/lib", "BINDIR=/usr/bin")
    configuration = {path for path in INSTALLED if path.startswith("etc/touchd/")}
    moved = {path.replace("etc/", "usr/lib/") for path in INSTALLED - configuration}
    assert files_in(tmp_path) == {*configuration, *moved, "usr/bin/touchd"}


def test_a_foreign_folder_is_never_deleted(make: Make, tmp_path: Path) -> None:
    (tmp_path / "opt/touchd").mkdir(parents=True)
    (tmp_path / "opt/touchd/thesis.tex").write_text("")
    said = make("install-program", "PYTHON=/usr/bin/python3", fails=True)
    assert "is there and is not an installed touchd" in said
    make("uninstall")
    assert files_in(tmp_path) == {"opt/touchd/thesis.tex"}


@pytest.mark.parametrize(
    ("program", "script", "said"),
    [
        (
            "python3",
            'case "$2" in *maxsize*) exit 1;; esac; exec {python} "$@"',
            "touchd needs a 64-bit system",
        ),
        ("uname", "echo Darwin", "touchd runs on Linux alone; elsewhere, use a virtual machine or WSL 2"),
    ],
)
def test_an_unfit_system_is_refused_in_one_line(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, script: str, said: str
) -> None:
    (tmp_path / program).write_text(f"#!/bin/sh\n{script.replace('{python}', sys.executable)}\n")
    (tmp_path / program).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    python = tmp_path / "python3" if program == "python3" else sys.executable
    assert said in make("install-program", f"PYTHON={python}", fails=True)
    assert files_in(tmp_path) == {program}


def test_an_upgrade_keeps_the_extras_that_are_installed(make: Make, tmp_path: Path) -> None:
    python = tmp_path / "opt/touchd/bin/python"
    python.parent.mkdir(parents=True)
    python.write_text(f"#!/bin/sh\nexec {sys.executable} $@")
    python.chmod(0o755)
    there = ran([python, "-m", "touchd.drivers.installed"], check=True).stdout.split()
    kept = [extra for extra in there if extra in ("mqtt", "lsl", "ros2", "rosbridge", "mcap", "nao")]
    shown = ("-n", "install-program", "PYTHON=python3")
    assert f"with live {' '.join(kept)} (" in make(*shown)
    assert "with live lsl ros2 (" in make(*shown, "EXTRAS=lsl,ros2")


@pytest.mark.parametrize(
    ("extra", "machine", "python", "instead"),
    [
        ("ros2", "aarch64", (3, 11), "x86_64 with Python below 3.14 alone; use rosbridge"),
        ("ros2", "x86_64", (3, 14), "x86_64 with Python below 3.14 alone; use rosbridge"),
        ("nao", "aarch64", (3, 11), "x86_64 with Python below 3.13 alone; leave robot.client out"),
        ("ros2", "x86_64", (3, 13), ""),
    ],
)
def test_nothing_is_advised_that_cannot_be_installed(
    extra: str, machine: str, python: tuple[int, int], instead: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(sys, "version_info", python)
    assert how_to_install(extra).endswith(instead)
    assert ("install" in how_to_install(extra)) == (instead == "")


def test_an_unknown_extra_is_refused(make: Make, tmp_path: Path) -> None:
    said = make("install-program", "EXTRAS=mqqt", f"PYTHON={sys.executable}", fails=True)
    assert "there is no extra mqqt; EXTRAS takes mqtt lsl" in said
    assert files_in(tmp_path) == set()


@pytest.mark.skipif(shutil.which("man") is None, reason="man is not installed")
def test_the_manual_page_has_every_command(tmp_path: Path) -> None:
    page = tmp_path / "touchd.1"
    page.write_text(ran([sys.executable, ROOT / "systemd/man.py"], check=True, cwd="/").stdout)
    shown = ran(["man", "--warnings", "-l", page], check=True)
    assert shown.stderr == ""
    for command in COMMANDS:
        assert f"touchd {command} " in shown.stdout
        assert f"usage: touchd {command}" in shown.stdout
    assert str(Path(sys.executable).parent) not in shown.stdout


@pytest.fixture
def pyproject() -> dict[str, Any]:
    tomllib = pytest.importorskip("tomllib", reason="this Python cannot read pyproject.toml")
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_python_package_is_installed(pyproject: dict[str, Any]) -> None:
    packages = {"touchd." + str(path.parent.relative_to(ROOT)).replace("/", ".") for path in PACKAGES}
    # Folders of data without code.
    packages |= {
        "touchd.docs",
        "touchd.daemon.live.static",
        "touchd.daemon.playback.data",
        "touchd.model.weights",
    }
    assert set(pyproject["tool"]["setuptools"]["packages"]) == packages


def test_every_page_that_a_message_names_is_installed(pyproject: dict[str, Any]) -> None:
    installed = set(pyproject["tool"]["setuptools"]["package-data"]["touchd.docs"])
    named: set[str] = set()
    for path in [*ROOT.glob("d*/**/*.py"), *ROOT.glob("model/*.py"), *ROOT.glob("model/adapt/*.py"), EXAMPLE]:
        text = path.read_text()
        named.update(f"{page}.md" for page in re.findall(r" docs ([a-z]+)[ `)\",]", text))
        comments = re.compile(r'#.*|""".*?"""', re.DOTALL if path.suffix == ".py" else 0)
        assert path == EXAMPLE or "docs/" not in re.sub(r"#.*", "", comments.sub("", text)), path
    assert len(named) > 4
    assert named <= installed
    assert all((ROOT / "docs" / page).exists() for page in installed)


@pytest.mark.skipif(shutil.which("systemd-tmpfiles") is None, reason="systemd-tmpfiles is not installed")
@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
def test_only_the_service_can_read_the_configuration(make: Make, tmp_path: Path) -> None:
    make("install-files")
    for table, line in (
        ("passwd", "root:x:0:0::/root:/bin/sh\ntouchd:x:977:976::/:/bin/false"),
        ("group", "root:x:0:\ntouchd:x:976:"),
    ):
        (tmp_path / "etc" / table).write_text(f"{line}\n")
    certificates = (tmp_path / CONFIGURATION).with_name("tls")
    certificates.mkdir()
    done = ran(["systemd-tmpfiles", "--create", f"--root={tmp_path}", "touchd.conf"])
    assert done.returncode == 0, done.stderr
    folder, file = (tmp_path / CONFIGURATION).parent.stat(), (tmp_path / CONFIGURATION).stat()
    assert (stat.S_IMODE(folder.st_mode), folder.st_gid) == (0o750, 976)
    assert (stat.S_IMODE(file.st_mode), file.st_uid, file.st_gid) == (0o640, 0, 976)
    # The service can still enter the folder.
    assert (stat.S_IMODE(certificates.stat().st_mode), certificates.stat().st_gid) == (0o750, 976)


def test_the_lock_satisfies_what_the_project_asks_for(pyproject: dict[str, Any]) -> None:
    project = pyproject["project"]
    locked: dict[str, list[str]] = {}
    for line in (ROOT / "requirements.lock").read_text().splitlines():
        if match := re.match(r"([\w.-]+)==([\w.]+)", line):
            locked.setdefault(match[1], []).append(match[2])
    extras = project["optional-dependencies"]
    # Installers and build tools are locked as well: they run with the same rights.
    wanted = ["pip", *pyproject["build-system"]["requires"], *project["dependencies"]]
    wanted += [text for extra in INSTALLED_EXTRAS for text in extras[extra]]
    for requirement in map(Requirement, wanted):
        versions = locked.get(requirement.name, [])
        assert versions, f"{requirement.name} is not locked; make lock"
        assert all(requirement.specifier.contains(version) for version in versions), (
            f"{requirement}; make lock"
        )


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
@pytest.mark.parametrize("version", ["3.10", "3.13", "3.14"])
def test_there_are_wheels_for_every_python_and_processor(version: str, machine: str) -> None:
    pytest.importorskip("uv")
    extras = [f"--extra={extra}" for extra in INSTALLED_EXTRAS]
    command = [sys.executable, "-m", "uv", "pip", "compile", "--only-binary=:all:", "pyproject.toml", *extras]
    platform = [f"--python-version={version}", f"--python-platform={machine}-unknown-linux-gnu"]
    done = ran([*command, *platform], cwd=ROOT)
    assert done.returncode == 0, done.stderr
    # qi has no wheels for the others.
    assert ("\nqi==" in done.stdout) == (machine == "x86_64" and version == "3.10")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A copy of the sources, to build in."""
    ignored = shutil.ignore_patterns(".*", "runs", "build", "*.egg-info")
    return shutil.copytree(ROOT, tmp_path / "source", ignore=ignored)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_built_wheel_installs_and_runs_in_a_clean_environment(tmp_path: Path, source: Path) -> None:
    python = tmp_path / "venv/bin/python"
    for command in (
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(tmp_path), str(source)],
        [sys.executable, "-m", "venv", str(tmp_path / "venv")],
        [str(python), "-m", "pip", "install", "--quiet", "--find-links", str(tmp_path), "touchd[nao,live]"],
    ):
        done = ran(command, cwd="/")
        assert done.returncode == 0, done.stderr
    touchd = python.with_name("touchd")
    assert '"type":"prediction"' in ran([touchd, "classify"], check=True, cwd="/").stdout
    assert ran([touchd, "config"], check=True, cwd="/").stdout == EXAMPLE.read_text()
    assert ran([touchd, "docs", "install"], check=True, cwd="/").stdout.startswith("# Installing touchd")
    loaded = subprocess.run([python, "-c", "import touchd.daemon.live.server"], check=False, cwd="/")
    assert loaded.returncode == 0


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("tool", ["uv", "pipx", "venv"])
def test_a_missing_extra_is_added_by_the_original_installer(
    tool: str, tmp_path: Path, source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("UV_TOOL_DIR", "UV_TOOL_BIN_DIR", "PIPX_HOME", "PIPX_BIN_DIR", "PIPX_MAN_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    monkeypatch.delenv("PYTHONPATH", raising=False)
    uv = [sys.executable, "-m", "uv"]
    pipx = [*uv, "tool", "run", "pipx"]
    commands, touchd, begins = {
        "uv": (
            [[*uv, "tool", "install", f"{source}[live]"]],
            tmp_path / "UV_TOOL_BIN_DIR/touchd",
            f"uv tool install 'touchd[live,mcap,rosbridge] @ file://{source}'",
        ),
        "pipx": (
            [[*pipx, "install", f"{source}[live]"]],
            tmp_path / "PIPX_BIN_DIR/touchd",
            "pipx inject touchd 'mcap>=1.2'",
        ),
        "venv": (
            [
                [*uv, "venv", str(tmp_path / "venv")],
                [*uv, "pip", "install", "--python", str(tmp_path / "venv"), f"{source}[live]"],
            ],
            tmp_path / "venv/bin/touchd",
            "uv pip install --python ",
        ),
    }[tool]
    for command in commands:
        done = ran(command, cwd="/", timeout=400)
        assert done.returncode == 0, done.stderr
    convert = [touchd, "convert", DEMO, "-o", tmp_path / "demo.mcap"]
    line = ran(convert, cwd="/").stderr.rstrip()
    said = line.partition("(extra mcap): ")[2]
    assert said.startswith(begins), line
    first, *rest = shlex.split(said)
    done = ran([*(pipx if first == "pipx" else uv), *rest], cwd="/", timeout=400)
    assert done.returncode == 0, done.stderr
    assert ran(convert, cwd="/").returncode == 0
    assert ran([touchd.resolve().with_name("python"), "-c", "import segno"], cwd="/").returncode == 0


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.skipif(
    Path(sys.executable).resolve().is_relative_to(Path.home()) and not Path("/usr/bin/python3").exists(),
    reason="there is only a Python in the home folder",
)
def test_the_installed_program_runs(make: Make, tmp_path: Path, source: Path) -> None:
    make("install", "PYTHON=/usr/bin/python3", "EXTRAS=mqtt", source=source)
    program = tmp_path / "opt/touchd/bin/touchd"
    assert program.read_text().startswith("#!/opt/touchd/bin/python")
    python = program.with_name("python")
    assert set(ran([python, "-m", "touchd.drivers.installed"], cwd="/").stdout.split()) >= {"live", "mqtt"}
    assert ran([python, "-c", "import pylsl"], cwd="/").returncode != 0
    done = ran([python, "-m", "touchd.daemon", "demo"], cwd="/")
    assert done.returncode == 0, done.stderr
    make("uninstall")
    assert files_in(tmp_path / "opt") == set()


def test_torch_comes_only_from_the_given_index(make: Make, tmp_path: Path) -> None:
    # It notes what it is asked for, and fails where the index is away.
    venv = tmp_path / "venv"
    (python := venv / "bin/python").parent.mkdir(parents=True)
    python.write_text(
        f'#!/bin/sh\necho "$@" >> {tmp_path}/asked\n'
        'case "$*" in *http://away*) echo gone >&2; exit 1;; esac\n'
    )
    python.chmod(0o755)
    said = make(str(venv / ".development.stamp"), f"VENV={venv}", "TORCH_INDEX=http://away", fails=True)
    assert "make test TORCH_INDEX= takes it from the ordinary index, with CUDA: 6 GB" in said
    (call,) = (tmp_path / "asked").read_text().splitlines()
    assert "--index-url http://away torch" in call
    assert (venv / "torch.log").read_text() == "gone\n"
