"""A Debian machine with its own systemd, which a test may fill, crash and reboot; removed at the end.

Two kinds: a container (systemd-nspawn), as fast as this machine, with this kernel; and an emulated machine
(QEMU) with a kernel, USB and power of its own, some fifty times slower. The folder handed over is mounted at
/mnt.
"""

import os
import shutil
import socket
import subprocess
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from by_hand.debian_disk import CACHE, call, hand_over, make_disk

# A machine that has not booted by then hangs.
BOOT_S = 400.0
BOOTED = "test ! -e /run/before && systemctl is-system-running --wait"
KERNEL = "root=/dev/vda rw console=ttyS0 quiet panic=-1"
SSH = (
    "BatchMode=yes",
    "StrictHostKeyChecking=no",
    "UserKnownHostsFile=/dev/null",
    "LogLevel=ERROR",
    "ConnectTimeout=30",
    # One connection for all commands: an emulated processor takes seconds to agree on keys.
    "ControlMaster=auto",
    "ControlPersist=60",
)


class Machine(ABC):
    """A running machine; every command runs in a shell, as root."""

    tools: Sequence[str]
    # How much slower it may be than this machine, and how much slower its pad than a real one.
    slower: float

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @abstractmethod
    def start(self, closing: ExitStack) -> None:
        """Switch it on; `closing` switches it off."""

    @abstractmethod
    def shell(self, command: str) -> Sequence[str]:
        """Return the command that runs a shell command on the machine."""

    def run(self, command: str, timeout_s: float = 120.0) -> str:
        """Run a command; returns what it printed; raises AssertionError when it fails."""
        done = self._done(command, timeout_s)
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
        return done.stdout.strip()

    def succeeds(self, command: str) -> bool:
        """Return whether a command succeeds."""
        return self._done(command, 120.0).returncode == 0

    def wait_until(self, command: str, timeout_s: float = 20.0) -> float:
        """Wait until a command succeeds; returns how long that took, in seconds."""
        began_s = time.monotonic()
        while not self.succeeds(command):
            assert time.monotonic() - began_s < timeout_s * self.slower, f"not in time: {command}"
            time.sleep(0.1)
        return time.monotonic() - began_s

    def write(self, path: str, text: str) -> None:
        """Write a file."""
        self._done(f"cat > {path}", 60.0, text).check_returncode()

    def reboot(self) -> None:
        """Reboot it; returns when it has booted."""
        self.run("touch /run/before")
        self._done("systemctl reboot", 60.0)
        self.await_boot()

    def await_boot(self) -> None:
        """Wait until it has booted."""
        deadline_s = time.monotonic() + BOOT_S
        while time.monotonic() < deadline_s:
            with suppress(subprocess.TimeoutExpired):
                if self._done(BOOTED, 90.0).returncode == 0:
                    return
            time.sleep(0.2)
        raise AssertionError(f"the machine has not booted within {BOOT_S:g} s")

    def _done(self, command: str, timeout_s: float, text: str = "") -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self.shell(command), input=text, capture_output=True, text=True, check=False, timeout=timeout_s
        )


class Container(Machine):
    """A systemd with its own processes, users, network and control groups, on this kernel."""

    tools = ("systemd-nspawn", "nsenter", "mmdebstrap", "mkfs.ext4", "ssh-keygen")
    slower = 1.0

    def start(self, closing: ExitStack) -> None:
        root, disk = self.folder / "root", self.folder / "disk.img"
        root.mkdir()
        call("cp", "--sparse=always", str(make_disk()), str(disk))
        call("mount", "-o", "loop", str(disk), str(root))
        closing.callback(call, "umount", "--lazy", str(root))
        given = self.folder / "given"
        command = ["systemd-nspawn", "--quiet", "--register=no", "--keep-unit", "--private-network", "--boot"]
        with (self.folder / "console").open("wb") as console:
            self._process = subprocess.Popen(
                [*command, f"--directory={root}", "--console=pipe", f"--bind-ro={given}:/mnt"],
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=console,
            )
        closing.callback(self._process.wait, 30)
        closing.callback(self._process.terminate)
        self.await_boot()

    def shell(self, command: str) -> Sequence[str]:
        pid = self._process.pid
        init = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        inside = ("nsenter", "--target", init[0], "--all") if init else ("false",)
        return [*inside, "/usr/bin/env", "PATH=/usr/sbin:/usr/bin:/sbin:/bin", "sh", "-c", command]


class Emulated(Machine):
    """An emulated machine, processor included. TOUCHD_ACCEL=kvm, where that works, is much faster."""

    tools = ("qemu-system-x86_64", "ssh", "mmdebstrap", "mkfs.ext4", "ssh-keygen")
    slower = 60.0

    def start(self, closing: ExitStack) -> None:
        disk, given = make_disk(), self.folder / "given.img"
        call("mkfs.ext4", "-q", "-d", str(self.folder / "given"), str(given), "1G")
        with socket.create_server(("127.0.0.1", 0)) as free:
            self._port = free.getsockname()[1]
        accelerated = os.environ.get("TOUCHD_ACCEL", "tcg,thread=multi")
        # An emulated processor's wide registers are slow.
        cpu = "Nehalem" if accelerated.startswith("tcg") else "host"
        command = [
            *("qemu-system-x86_64", "-accel", accelerated, "-cpu", cpu, "-smp", "2", "-m", "2048"),
            *("-display", "none", "-snapshot", "-serial", f"file:{self.folder / 'console'}"),
            *("-kernel", str(CACHE / "vmlinuz"), "-initrd", str(CACHE / "initrd.img"), "-append", KERNEL),
            *("-drive", f"file={disk},format=raw,if=virtio", "-drive", f"file={given},format=raw,if=virtio"),
            *("-nic", f"user,model=virtio-net-pci,hostfwd=tcp:127.0.0.1:{self._port}-:22"),
            *("-monitor", f"unix:{self.folder / 'monitor'},server,nowait"),
        ]
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        closing.callback(process.wait)
        closing.callback(process.kill)
        self.await_boot()
        self.run("echo '/dev/vdb /mnt ext4 ro' >> /etc/fstab && mount /mnt")

    def cut_power(self) -> None:
        """Cut the power without warning and restore it; returns when it has booted."""
        self.run("touch /run/before")
        with socket.socket(socket.AF_UNIX) as monitor:
            monitor.connect(str(self.folder / "monitor"))
            monitor.sendall(b"system_reset\n")
            time.sleep(1.0)
        self.await_boot()

    def shell(self, command: str) -> Sequence[str]:
        options = [f"-o{option}" for option in (*SSH, f"ControlPath={self.folder / 'ssh'}")]
        return ["ssh", *options, "-i", str(CACHE / "key"), "-p", str(self._port), "root@127.0.0.1", command]


KINDS: dict[str, type[Machine]] = {"container": Container, "emulated": Emulated}


def what_is_missing(kind: type[Machine]) -> str:
    """Return why such a machine cannot run here, "" if it can."""
    if missing := [tool for tool in kind.tools if shutil.which(tool) is None]:
        return f"not installed: {', '.join(missing)}"
    return "" if os.geteuid() == 0 else "only root can make a machine"


@contextmanager
def booted(kind: type[Machine]) -> Iterator[Machine]:
    """A booted machine; removed at the end."""
    with ExitStack() as closing:
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="touchd-debian-")))
        hand_over(folder / "given")
        machine = kind(folder)
        machine.start(closing)
        yield machine
