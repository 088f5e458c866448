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


def tried(given: argparse.Namespace, file: str, folder: Path, copy: Path) -> list[dict[str, Any]]:
    """Return each mutant's line, what it became, and which test caught it, if any."""
    mutants, report = folder / "mutants.jsonl", folder / "report.jsonl"
    with mutants.open("w") as listed:
        mutate = [
            given.tool / "bin/python",
            ROOT / "tests/by_hand/mutate.py",
            f"--sample={given.sample}",
            file,
        ]
        subprocess.run(mutate, cwd=copy, stdout=listed, check=True)
    variables = {"FILE": file, "LIST": mutants, "REPORT": report, "SECONDS": given.seconds}
    environment = {f"MUTANTS_{name}": str(value) for name, value in variables.items()}
    environment |= {"PYTHONPATH": f"{folder}:tests", "OPENBLAS_NUM_THREADS": "1"}
    pytest = [
        sys.executable,
        "-m",
        "pytest",
        "-n",
        "0",
        "-p",
        "no:cacheprovider",
        "-p",
        "by_hand.mutant_runner",
    ]
    done = subprocess.run(
        [*pytest, *given.tests.split()],
        cwd=copy,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    if not report.exists():
        sys.exit(done.stdout)
    return [json.loads(line) for line in report.read_text().splitlines()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tool", type=Path, required=True, help="the virtual environment with cosmic-ray")
    parser.add_argument("--tests", default="tests", help="which tests to run against each mutant")
    parser.add_argument("--sample", type=int, default=0, help="how many mutants of a file; 0: all")
    parser.add_argument("--seconds", type=float, default=4.0, help="of processor for a mutant's tests")
    parser.add_argument("files", nargs="+")
    given = parser.parse_args()
    given.tool = given.tool.absolute()
    lines: list[str] = []
    rows = ["| file | faults | caught |", "|---|---|---|"]
    for file in given.files:
        with tempfile.TemporaryDirectory() as name:
            mutants = tried(given, file, Path(name), copy_of_tree(Path(name)))
        missed = [mutant for mutant in mutants if not mutant["caught"]]
        lines += [f"{file}:{mutant['line']}: {mutant['changed']}" for mutant in missed]
        caught = len(mutants) - len(missed)
        rows.append(f"| `{file}` | {len(mutants)} | {caught} ({caught / len(mutants):.0%}) |")
    sys.stdout.write("\n".join([*lines, *rows, ""]))


if __name__ == "__main__":
    main()
