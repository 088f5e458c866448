"""The table of errors in docs/architecture.md."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_table_of_errors_names_every_error_and_its_file() -> None:
    found = {
        (node.name, str(path.relative_to(ROOT)))
        for package in ("daemon", "drivers", "model")
        for path in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef) and "TouchdError" in map(ast.unparse, node.bases)
    }
    page = (ROOT / "docs" / "architecture.md").read_text()
    assert set(re.findall(r"^\| `(\w+)` \| `(\S+\.py)` \|", page, re.MULTILINE)) == found
