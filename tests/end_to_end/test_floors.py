"""The layers: model may import drivers, daemon both, and nothing imports upward."""

import ast
import re
import sys
from collections.abc import Set
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from rigs.programs import ran

ROOT = Path(__file__).parents[2]
TRAINING = ROOT / "model" / "training"
# Not installed yet: the daemon does not use it.
DETECTOR = ROOT / "model" / "detector"
STUDIES = ROOT / "model" / "studies"


@cache
def imports(path: Path) -> frozenset[str]:
    """Return the dotted names of all modules that a file imports."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path} imports relatively"
            found.add(node.module)
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return frozenset(found)


def from_package(names: Set[str], package: str) -> set[str]:
    return {name for name in names if name == package or name.startswith(f"{package}.")}


@pytest.mark.parametrize("path", sorted(ROOT.glob("drivers/**/*.py")), ids=lambda path: path.name)
def test_drivers_import_nothing_above_them(path: Path) -> None:
    names = imports(path)
    assert not from_package(names, "touchd.model") | from_package(names, "touchd.daemon")


INSTALLED_MODEL = [*ROOT.glob("model/*.py"), *ROOT.glob("model/adapt/*.py")]


@pytest.mark.parametrize("path", sorted(INSTALLED_MODEL), ids=lambda path: path.name)
def test_the_model_imports_nothing_of_the_daemon(path: Path) -> None:
    assert not from_package(imports(path), "touchd.daemon")


@pytest.mark.parametrize("package", ["drivers", "model", "daemon"])
def test_the_studies_stand_above_everything(package: str) -> None:
    for path in ROOT.glob(f"{package}/**/*.py"):
        names = imports(path)
        if not path.is_relative_to(STUDIES):
            assert not from_package(names, "touchd.model.studies"), path
            if not path.is_relative_to(TRAINING) and not path.is_relative_to(DETECTOR):
                assert not from_package(names, "touchd.model.training"), path


def files() -> dict[str, Set[str]]:
    """Return, for each module of the installed packages, those that it imports."""
    modules = {
        ".".join(("touchd", *path.relative_to(ROOT).with_suffix("").parts)): path
        for package in ("drivers", "daemon", "model")
        for path in ROOT.glob(f"{package}/**/*.py")
        if path.name != "__init__.py" and not path.is_relative_to(STUDIES)
    }
    return {name: imports(path) & modules.keys() - {name} for name, path in modules.items()}


def test_no_files_import_each_other_in_a_circle() -> None:
    TopologicalSorter(files()).prepare()


WHAT_IS_LOADED = """
import sys
from touchd.daemon.commands import run
from touchd.daemon.app.config import Settings
from touchd.daemon.app.parts import make_parts
from touchd.drivers.queue import Signal
make_parts(Settings(), print, tuple, Signal())
print(*sys.modules)
"""


@pytest.fixture(scope="module")
def loaded() -> set[str]:
    """The modules that a daemon has loaded when it is ready."""
    done = ran([sys.executable, "-c", WHAT_IS_LOADED], check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "names",
    [
        pytest.param({"torch", "onnx", "sklearn", "matplotlib", "scipy"}, id="training, pictures"),
        pytest.param({"rich", "websockets", "asyncio"}, id="view, page"),
        pytest.param({"qi", "paho", "pylsl", "cyclonedds", "mcap"}, id="robot, bridges"),
    ],
)
def test_the_running_daemon_loads_no_unconfigured_library(loaded: set[str], names: set[str]) -> None:
    assert "onnxruntime" in loaded
    assert not loaded & names


def test_the_architecture_page_names_existing_paths() -> None:
    names = re.findall(
        r"`((?:daemon|docs|drivers|model|tests)/[\w/]*(?:\.\w+)?)`",
        (ROOT / "docs/architecture.md").read_text(),
    )
    assert len(names) > 30
    assert [name for name in names if not (ROOT / name).exists()] == []


def test_the_command_line_starts_without_loading_anything_heavy() -> None:
    done = ran([sys.executable, "-c", "import sys, touchd.daemon.app.cli; print(*sys.modules)"], check=True)
    assert not set(done.stdout.split()) & {"numpy", "onnxruntime", "msgspec", "yaml", "rich", "torch"}
