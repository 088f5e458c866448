"""How many small changes of a module its tests catch; cosmic-ray makes the changes. See `make mutants`.

Works in a copy of the tree, so that the files here never hold a mutant. Each mutant costs a run of the tests
that are named, up to the first that fails.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
# A mutant that takes this many times as long as the tests, and this much more, waits for ever.
PATIENCE, PATIENCE_S = 3.0, 20.0


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


def passes(tests: list[str], copy: Path, limit_s: float | None = None) -> bool:
    """Run tests in the copy until one fails or the limit is over."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *tests]
    # Without stored bytecode, a mutant that is written within the same second is read too.
    own = {"PYTHONPATH": f"{copy.parent}:tests", "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(command, cwd=copy, env=os.environ | own, capture_output=True, timeout=limit_s)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def missed(given: argparse.Namespace, file: str, copy: Path) -> tuple[int, list[str]]:
    """Return how many mutants a file has, and the lines of those that all tests let through."""
    mutate = [given.tool / "bin/python", ROOT / "tests/by_hand/mutate.py", f"--sample={given.sample}", file]
    mutants = subprocess.check_output(mutate, cwd=copy, text=True).splitlines()
    tests, path = given.tests.split(), copy / file
    source, began_s = path.read_text(), time.monotonic()
    if not passes(tests, copy):
        sys.exit(f"{given.tests}: fails without a mutant")
    limit_s = PATIENCE_S + PATIENCE * (time.monotonic() - began_s)
    let_through = []
    for mutant in map(json.loads, mutants):
        path.write_text(mutant["code"])
        if passes(tests, copy, limit_s):
            changed = mutant["code"].splitlines()[mutant["line"] - 1].strip()
            let_through.append(f"{file}:{mutant['line']}: {changed}")
    path.write_text(source)
    return len(mutants), let_through


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tool", type=Path, required=True, help="the virtual environment with cosmic-ray")
    parser.add_argument("--tests", default="tests", help="which tests to run against each mutant")
    parser.add_argument("--sample", type=int, default=0, help="how many mutants of a file; 0: all")
    parser.add_argument("files", nargs="+")
    given = parser.parse_args()
    given.tool = given.tool.absolute()
    sys.stdout.write("| file | faults | caught |\n|---|---|---|\n")
    with tempfile.TemporaryDirectory() as folder:
        copy = copy_of_tree(Path(folder))
        for file in given.files:
            count, lines = missed(given, file, copy)
            caught = count - len(lines)
            sys.stdout.write(f"| `{file}` | {count} | {caught} ({caught / count:.0%}) |\n")
            sys.stderr.write("".join(f"{line}\n" for line in lines))


if __name__ == "__main__":
    main()
