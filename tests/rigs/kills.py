"""Kills a piece of work at every step that it takes on the disk, as a power cut or `kill -9` would."""

import os
import resource
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

STEPS = {"open", "os.link", "os.rename", "os.remove", "os.chmod", "os.chown", "os.truncate"}
# Bytes after which a write is cut short.
SIZES = (0, 1, 1000, 100_000)


def killed_everywhere(folder: Path, work: Callable[[], None]) -> Iterator[str]:
    """Do the work in forked processes, each killed at another step in the folder; yields each such step.

    Use it in a process with one thread only.
    """
    for size in SIZES:
        if not _ends_by_itself(lambda size=size: _limit(size), work):
            yield f"a write after {size} bytes"
    step = 1
    while not _ends_by_itself(lambda: _kill_at(folder, step), work):  # noqa: B023
        yield f"step {step}"
        step += 1


def _ends_by_itself(prepare: Callable[[], None], work: Callable[[], None]) -> bool:
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        prepare()
        try:
            work()
        except BaseException:
            sys.excepthook(*sys.exc_info())
            os._exit(1)
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    assert os.WIFSIGNALED(status) or status == 0
    return status == 0


def _limit(size: int) -> None:
    # Python ignores the signal by which the kernel ends a program that writes too much.
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def _kill_at(folder: Path, step: int) -> None:
    seen = 0

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal seen
        if event in STEPS and str(folder) in str(arguments[0]):
            seen += 1
            if seen == step:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)
