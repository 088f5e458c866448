"""Runs in place of the unit, under all its rules: prints as JSON what worked, and how the rest failed."""

import ctypes
import json
import mmap
import os
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path

LIBC = ctypes.CDLL(None, use_errno=True)
CLONE_NEWUSER = 0x10000000


def write(path: str) -> Callable[[], object]:
    return lambda: Path(path).write_text("")


def read(path: str) -> Callable[[], object]:
    return lambda: os.read(os.open(path, os.O_RDONLY | os.O_NONBLOCK), 1)


def call(name: str, *arguments: object) -> Callable[[], object]:
    """Return a wrapper of a C library function that raises OSError with its errno."""

    def called() -> None:
        if getattr(LIBC, name)(*arguments) < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))

    return called


def set_user_id_bit() -> None:
    path = Path("/tmp/probe")
    path.write_text("")
    path.chmod(0o4755)


ATTEMPTS: dict[str, Callable[[], object]] = {
    "write its state": write("/var/lib/touchd/probe"),
    "read its configuration": read("/etc/touchd/touchd.yaml"),
    "open the pad": read("/dev/touchd-pad"),
    "reach the robot": lambda: socket.create_connection(("127.0.0.1", 9559), 5).close(),
    "change its configuration": write("/etc/touchd/touchd.yaml"),
    "change its program": write("/opt/touchd/bin/touchd"),
    "write /etc": write("/etc/probe"),
    "write /usr": write("/usr/probe"),
    "write /var": write("/var/lib/probe"),
    "write /run": write("/run/probe"),
    "read shadow": read("/etc/shadow"),
    "see /home": lambda: os.listdir("/home/somebody"),
    "see /root": lambda: os.listdir("/root"),
    "see other processes": lambda: Path("/proc/1/comm").read_text(),
    "open another device": read("/dev/touchd-probe"),
    "open kernel messages": read("/dev/kmsg"),
    "become root": lambda: os.setuid(0),
    "make a namespace": call("unshare", CLONE_NEWUSER),
    "mount": call("mount", b"none", b"/tmp", b"tmpfs", 0, None),
    "set the clock": lambda: time.clock_settime(time.CLOCK_REALTIME, time.time()),
    "set the host name": call("sethostname", b"probe", 5),
    "raise its priority": lambda: os.setpriority(os.PRIO_PROCESS, 0, -5),
    "run in real time": lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1)),
    "open a raw socket": lambda: socket.socket(socket.AF_PACKET, socket.SOCK_RAW),
    "have memory that is written and run": lambda: mmap.mmap(
        -1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC
    ),
    "make a set-user-id file": set_user_id_bit,
    "trace a process": call("ptrace", 0, 0, None, None),
}


def main() -> None:
    """Try everything; prints {attempt: "done" or why not}."""
    outcome = {}
    for name, attempt in ATTEMPTS.items():
        try:
            attempt()
            outcome[name] = "done"
        except OSError as error:
            outcome[name] = str(error.strerror)
    sys.stdout.write(json.dumps(outcome) + "\n")


if __name__ == "__main__":
    main()
