"""How many small changes of a module its tests catch; cosmic-ray makes the changes. See `make mutants`.

Works in a copy of the tree, so that the files here never hold a mutant.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
# Tests that take longer wait for ever.
TIMEOUT_S = 60.0
# Left out: mutants of annotations, of bits, and of identity, which for short strings and whole numbers is
# equality.
EXCLUDED = (
    "core/ReplaceBinaryOperator_BitOr_.*",
    "core/ReplaceBinaryOperator_.*_(Pow|Mod|FloorDiv|LShift|RShift|BitOr|BitAnd|BitXor)",
    "core/ReplaceComparisonOperator_(Eq|NotEq|Lt|LtE|Gt|GtE)_(Is|IsNot)",
    "core/RemoveDecorator",
)


def copy_of_tree(folder: Path) -> Path:
    """Copy what git knows or would add; return the copy, which `folder` makes importable as touchd."""
    copy = folder / "tree"
    listed = subprocess.check_output(
        ["git", "ls-files", "-co", "--exclude-standard", "-z"], cwd=ROOT, text=True
    )
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy / name)
    (folder / "touchd").symlink_to(copy)
    return copy


def tried(tool: Path, file: str, tests: str, folder: Path, copy: Path) -> list[Any]:
    """Return cosmic-ray's pairs of a mutant and its result."""
    config, session = folder / "config.toml", folder / f"{file.replace('/', '.')}.sqlite"
    command = f"{sys.executable} -m pytest -x -n 0 -p no:cacheprovider {tests}"
    config.write_text(
        f"[cosmic-ray]\nmodule-path = {file!r}\ntimeout = {TIMEOUT_S}\nexcluded-modules = []\n"
        f"test-command = {command!r}\n[cosmic-ray.distributor]\nname = 'local'\n"
        f"[cosmic-ray.filters.operators-filter]\nexclude-operators = {list(EXCLUDED)!r}\n"
    )
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}

    def run(name: str, *arguments: str | Path) -> str:
        asked = [tool / "bin" / name, *arguments]
        return subprocess.run(
            asked, cwd=copy, env=environment, stdout=subprocess.PIPE, text=True, check=True
        ).stdout

    run("cosmic-ray", "baseline", config)
    run("cosmic-ray", "init", config, session)
    run("cr-filter-operators", session, config)
    run("cosmic-ray", "exec", config, session)
    return [json.loads(line) for line in run("cosmic-ray", "dump", session).splitlines()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tool", type=Path, required=True, help="the virtual environment with cosmic-ray")
    parser.add_argument("--tests", default="tests", help="what pytest runs for each mutant")
    parser.add_argument("files", nargs="+")
    given = parser.parse_args()
    lines: list[str] = []
    rows = ["| file | mutants | caught |", "|---|---|---|"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copy = copy_of_tree(folder)
        for file in given.files:
            pairs = tried(given.tool.resolve(), file, given.tests, folder, copy)
            counted = [(item, result) for item, result in pairs if result["worker_outcome"] != "skipped"]
            survived = [item for item, result in counted if result["test_outcome"] == "survived"]
            places = [
                (item["mutations"][0]["start_pos"][0], item["mutations"][0]["operator_name"])
                for item in survived
            ]
            lines += [f"{file}:{line}: {change} survives" for line, change in sorted(places)]
            caught = len(counted) - len(survived)
            rows.append(f"| `{file}` | {len(counted)} | {caught} ({caught / len(counted):.0%}) |")
    sys.stdout.write("\n".join([*lines, *rows, ""]))


if __name__ == "__main__":
    main()
