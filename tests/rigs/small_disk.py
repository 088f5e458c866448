"""A disk of a few kilobytes, for programs to fill."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from rigs.programs import ran

needs_small_disk = pytest.mark.skipif(
    subprocess.run(
        ["unshare", "--mount", "mount", "-t", "tmpfs", "none", "/mnt"], capture_output=True, check=False
    ).returncode
    != 0,
    reason="a small disk cannot be mounted here",
)


def log_on_small_disk(folder: Path, kilobytes: int, program: str) -> list[str]:
    """Run Python code with such a disk mounted at `folder`, its first argument; return what it logged."""
    mounted = f'mount -t tmpfs -o size={kilobytes}k none "$0" && exec "$@"'
    done = ran(
        ["unshare", "--mount", "sh", "-c", mounted, str(folder), sys.executable, "-c", program, str(folder)],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
    )
    assert done.returncode == 0, done.stderr
    return done.stderr.splitlines()
