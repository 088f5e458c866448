"""The layers of the code, and that the documentation names only what exists."""

import ast
import re
import shlex
import sys
from collections.abc import Set
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from rigs.programs import ran

from touchd.daemon.app.cli import COMMANDS, options_of
from touchd.daemon.app.config import load
from touchd.model.studies.__main__ import STUDIES, main

ROOT = Path(__file__).parents[2]


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


# Which files import no module of a package. Of the model, training and studies are not installed.
CLOSED = [
    ("drivers", (), ("model", "daemon")),
    ("model", ("training", "studies"), ("daemon",)),
    ("model", ("training", "studies"), ("model.training",)),
    ("model", ("studies",), ("model.studies",)),
    ("daemon", (), ("model.training", "model.studies")),
]


@pytest.mark.parametrize(("floor", "but", "above"), CLOSED)
def test_no_floor_imports_what_is_above_it(floor: str, but: tuple[str, ...], above: tuple[str, ...]) -> None:
    paths = [path for path in (ROOT / floor).rglob("*.py") if path.parts[len(ROOT.parts) + 1] not in but]
    found = [
        (path, package)
        for path in paths
        for package in above
        if from_package(imports(path), f"touchd.{package}")
    ]
    assert (len(paths) > 10, found) == (True, [])


def files() -> dict[str, Set[str]]:
    """Return, for each module of the installed packages, those that it imports."""
    modules = {
        ".".join(("touchd", *path.relative_to(ROOT).with_suffix("").parts)): path
        for package in ("drivers", "daemon", "model")
        for path in ROOT.glob(f"{package}/**/*.py")
        if path.name != "__init__.py" and not path.is_relative_to(ROOT / "model/studies")
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


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
WITH_FIRMWARE = [*PAGES, ROOT / "drivers/firmware/README.md"]
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


def typed(page: Path) -> list[list[str]]:
    """Return the commands of a page's shell blocks as words."""
    blocks = re.findall(r"```sh\n(.*?)```", page.read_text(), re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    words = [shlex.split(line, comments=True) for line in lines]
    return [line[line[0] == "sudo" :] for line in words if line]


@pytest.mark.parametrize("study", STUDIES)
def test_every_study_prints_help(study: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    with pytest.raises(SystemExit) as ended:
        main([study, "--help"])
    assert ended.value.code == 0
    assert f"usage: python -m touchd.model.studies {study}" in capsys.readouterr().out


def test_an_unknown_study_is_named_below_the_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evalute"]) == 2
    assert capsys.readouterr().err.endswith("\n\nevalute is not one of them\n")


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", WITH_FIRMWARE, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_and_picture_exists(page: Path) -> None:
    for name, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", page.read_text()):
        target = page.parent / name if name else page
        assert target.exists(), name
        assert not anchor or anchor in anchors(target), f"{name}#{anchor}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_can_be_typed_as_it_stands(page: Path) -> None:
    for first, *rest in typed(page):
        if Path(first).name == "touchd" and rest[0] in COMMANDS:
            options_of(rest[0], rest[1:])
        elif Path(first).name == "touchd":
            assert rest[0] in ("--help", "--version"), rest
        elif first == "make":
            assert {word for word in rest if "=" not in word} <= TARGETS, rest
        elif rest[:2] == ["-m", "touchd.model.studies"]:
            assert rest[2] in STUDIES, rest


@pytest.mark.parametrize("page", WITH_FIRMWARE, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_configuration_on_a_page_is_accepted(page: Path, tmp_path: Path) -> None:
    for block in re.findall(r"```yaml\n(.*?)```", page.read_text(), re.DOTALL):
        path = tmp_path / "touchd.yaml"
        # What is commented out is accepted, too.
        path.write_text(re.sub(r"^( *)#(\w)", r"\1\2", block, flags=re.MULTILINE))
        load(path)
