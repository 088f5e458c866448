"""A Debian with its own systemd in a container (systemd-nspawn), which a test may fill and crash.

What is downloaded is kept in the folder TOUCHD_DEBIAN, by default /var/tmp/touchd-debian. The sources, their
wheels, recordings and helpers are mounted at /mnt.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import tomllib

ROOT = Path(__file__).parents[2]
CACHE = Path(os.environ.get("TOUCHD_DEBIAN", "/var/tmp/touchd-debian"))
PACKAGES = "systemd,systemd-sysv,udev,dbus,python3,python3-venv,make"
# The wheels are fetched for Debian 12's own Python.
PYTHON = "3.11"
TOOLS = ("systemd-nspawn", "nsenter", "mmdebstrap", "git")
MISSING = [tool for tool in TOOLS if shutil.which(tool) is None]
WHY_NOT = f"not installed: {', '.join(MISSING)}" if MISSING else "only root can" if os.geteuid() else ""
BOOT_S = 120.0


class Container:
    """A booted container; every command runs in a shell, as root."""

    def __init__(self, nspawn: int) -> None:
        self._nspawn = nspawn

    def run(self, command: str, timeout_s: float = 120.0) -> str:
        """Run a command; returns what it printed; raises AssertionError when it fails."""
        done = self._done(command, timeout_s)
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
        return done.stdout.strip()

    def succeeds(self, command: str) -> bool:
        return self._done(command, 120.0).returncode == 0

    def wait_until(self, command: str, timeout_s: float = 20.0) -> float:
        """Wait until a command succeeds; returns how long that took, in seconds."""
        began_s = time.monotonic()
        while not self.succeeds(command):
            assert time.monotonic() - began_s < timeout_s, f"not in time: {command}"
            time.sleep(0.1)
        return time.monotonic() - began_s

    def write(self, path: str, text: str) -> None:
        self._done(f"cat > {path}", 60.0, text).check_returncode()

    def _done(self, command: str, timeout_s: float, text: str = "") -> subprocess.CompletedProcess[str]:
        init = Path(f"/proc/{self._nspawn}/task/{self._nspawn}/children").read_text().split()
        inside = ["nsenter", "--target", init[0], "--all"] if init else ["false"]
        shell = ["/usr/bin/env", "PATH=/usr/sbin:/usr/bin:/sbin:/bin", "sh", "-c", command]
        return subprocess.run(
            [*inside, *shell], input=text, capture_output=True, text=True, check=False, timeout=timeout_s
        )


@contextmanager
def booted() -> Iterator[Container]:
    """Yield a booted container; it is removed at the end."""
    with ExitStack() as closing:
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="touchd-debian-")))
        root, given = folder / "root", folder / "given"
        root.mkdir()
        _call("tar", "--extract", f"--directory={root}", f"--file={_debian()}")
        _hand_over(given)
        command = ["systemd-nspawn", "--quiet", "--register=no", "--keep-unit", "--private-network", "--boot"]
        console = closing.enter_context((folder / "console").open("wb"))
        nspawn = subprocess.Popen(
            [*command, f"--directory={root}", "--console=pipe", f"--bind-ro={given}:/mnt"],
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=console,
        )
        closing.callback(nspawn.wait, 30)
        closing.callback(nspawn.terminate)
        container = Container(nspawn.pid)
        with suppress(AssertionError):
            container.wait_until("systemctl is-system-running --wait", BOOT_S)
        assert container.succeeds("true"), (folder / "console").read_text()
        yield container


def _debian() -> Path:
    """Return an archive of Debian 12 with systemd and Python, made once."""
    archive = CACHE / "debian.tar"
    if not archive.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        unfinished = CACHE / "unfinished.tar"
        _call(
            "mmdebstrap", "--quiet", "--variant=minbase", f"--include={PACKAGES}", "bookworm", str(unfinished)
        )
        unfinished.rename(archive)
    return archive


def _hand_over(folder: Path) -> None:
    wheels = CACHE / "wheels"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    chosen = ["--only-binary=:all:", f"--python-version={PYTHON}", "--platform=manylinux2014_x86_64"]
    chosen += [f"--platform=manylinux_2_{minor}_x86_64" for minor in (17, 24, 26, 27, 28, 34, 35)]
    for wanted in (["-r", str(ROOT / "requirements.lock")], [*project["build-system"]["requires"], "wheel"]):
        _call(sys.executable, "-m", "pip", "download", "--quiet", "-d", str(wheels), *chosen, *wanted)
    shutil.copytree(wheels, folder / "wheels")
    shutil.copytree(ROOT / "tests/recordings", folder / "recordings")
    shutil.copytree(ROOT / "tests/by_hand/on_the_machine", folder / "helpers")
    tracked = subprocess.run(["git", "-C", str(ROOT), "ls-files"], capture_output=True, text=True, check=True)
    for name in tracked.stdout.splitlines():
        (folder / "touchd" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / "touchd" / name)


def _call(*command: str) -> None:
    """Run a program; raises AssertionError with its output when it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"
