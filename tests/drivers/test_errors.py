"""The page of errors in `touchd.drivers.errors`."""

import ast
import re
from pathlib import Path

from touchd.drivers import errors

ROOT = Path(__file__).parents[2]


def test_the_page_of_errors_names_every_error_and_its_file() -> None:
    found = {
        (node.name, str(path.relative_to(ROOT)))
        for package in ("daemon", "drivers", "model")
        for path in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef) and "TouchdError" in map(ast.unparse, node.bases)
    }
    assert set(re.findall(r"^    (\w+) +(\S+\.py)", errors.__doc__ or "", re.MULTILINE)) == found
