"""The documentation names only existing tests, files, commands and options."""

import importlib
import re
import shlex
from pathlib import Path

import pytest

from touchd.daemon.app.cli import COMMANDS, module_of
from touchd.daemon.app.config import load
from touchd.model.studies.__main__ import STUDIES, main

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
WITH_FIRMWARE = [*PAGES, ROOT / "drivers/firmware/README.md"]
MODULES = {command: module_of(command) for command in COMMANDS}
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
        if Path(first).name == "touchd" and rest[0] in MODULES:
            importlib.import_module(MODULES[rest[0]]).parser().parse_args(rest[1:])
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
