"""The tests that docs/reliability.md names are there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_reliability_names_tests_that_there_are() -> None:
    page = (ROOT / "docs" / "reliability.md").read_text()
    files = list((ROOT / "tests").rglob("*.py"))
    known = [path.stem for path in files]
    for path in files:
        known += re.findall(r"^ *(?:def|class) (test\w+)", path.read_text(), re.MULTILINE)
    named = set(re.findall(r"`((?:test_|…)\w[\w…]*)`", page))
    assert len(named) > 80
    unknown = {
        name for name in named if not re.search(rf"^{name.replace('…', '.*')}$", "\n".join(known), re.M)
    }
    assert not unknown
