"""The disk of a Debian machine to install the service on, and the folder handed to it.

Both are made once and kept in the folder TOUCHD_DEBIAN, by default /var/tmp/touchd-debian.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import tomllib

ROOT = Path(__file__).parents[2]
CACHE = Path(os.environ.get("TOUCHD_DEBIAN", "/var/tmp/touchd-debian"))
# The wheels are fetched for Debian 12's own Python.
PYTHON = "3.11"
PACKAGES = "systemd,systemd-sysv,udev,dbus,linux-image-amd64,python3,python3-venv,make,openssh-server,kmod"
SOURCES = (
    "daemon",
    "drivers",
    "model",
    "systemd",
    "Makefile",
    "pyproject.toml",
    "requirements.lock",
    "README.md",
    "LICENSE",
)
NETWORK = "[Match]\nName=en*\n[Network]\nDHCP=yes\n"


def make_disk() -> Path:
    """Return an image of a disk with Debian 12, its kernel, systemd, udev and ssh, made once."""
    disk = CACHE / "disk.img"
    if disk.exists():
        return disk
    CACHE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=CACHE, prefix="root-") as folder:
        root = Path(folder) / "root"
        call("mmdebstrap", "--quiet", "--variant=minbase", f"--include={PACKAGES}", "bookworm", str(root))
        (CACHE / "key").unlink(missing_ok=True)
        call("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(CACHE / "key"))
        (root / "root/.ssh").mkdir(mode=0o700, exist_ok=True)
        shutil.copy(CACHE / "key.pub", root / "root/.ssh/authorized_keys")
        (root / "etc/hostname").write_text("lab\n")
        (root / "etc/systemd/network/20-lab.network").write_text(NETWORK)
        call("systemctl", f"--root={root}", "--quiet", "enable", "systemd-networkd")
        for name in ("vmlinuz", "initrd.img"):
            shutil.copy(next((root / "boot").glob(f"{name}-*")), CACHE / name)
        unfinished = disk.with_suffix(".partial")
        call("mkfs.ext4", "-q", "-d", str(root), str(unfinished), "4G")
        unfinished.rename(disk)
    return disk


def hand_over(folder: Path) -> None:
    """Fill a folder for the machine: the sources, their wheels, recordings and helpers."""
    wheels = CACHE / "wheels"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    chosen = ["--only-binary=:all:", f"--python-version={PYTHON}", "--platform=manylinux2014_x86_64"]
    chosen += [f"--platform=manylinux_2_{minor}_x86_64" for minor in (17, 24, 26, 27, 28, 34, 35)]
    for wanted in (["-r", str(ROOT / "requirements.lock")], [*project["build-system"]["requires"], "wheel"]):
        call(sys.executable, "-m", "pip", "download", "--quiet", "-d", str(wheels), *chosen, *wanted)
    for source in SOURCES:
        _copy(ROOT / source, folder / "touchd" / source)
    _copy(ROOT / "tests/recordings", folder / "recordings")
    _copy(ROOT / "tests/by_hand/on_the_machine", folder / "helpers")
    _copy(wheels, folder / "wheels")


def call(*command: str) -> None:
    """Run a program; raises AssertionError with its output when it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    else:
        shutil.copy(source, target)
