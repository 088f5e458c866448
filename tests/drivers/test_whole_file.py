"""Atomic writes: a file is replaced whole or not at all."""

import shutil
from pathlib import Path

import pytest

from drivers.whole_file import whole_file


def test_a_replaced_file_keeps_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "touchd.yaml"
    path.write_text("before")
    path.chmod(0o640)
    with whole_file(path) as partial:
        partial.write_text("after")
    assert (path.read_text(), path.stat().st_mode & 0o777) == ("after", 0o640)


def test_an_error_while_writing_leaves_the_old_file_alone(tmp_path: Path) -> None:
    path = tmp_path / "touchd.yaml"
    path.write_text("before")
    with pytest.raises(FileNotFoundError), whole_file(path) as partial:
        shutil.copytree(tmp_path / "not there", partial)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]
