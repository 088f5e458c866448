"""Runs LSL and ROS 2 in a separate process, as anybody on the network can fill the memory of their libraries.

liblsl stores a request of any length, DDS every participant that announces itself; neither has a limit. If
the process grows by more than MOST_MB it ends, and the daemon starts another.
`python -m touchd.daemon.bridges.process` is that process.
"""

import math
import os
import pickle
import resource
import select
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Protocol

from touchd.daemon.bridges.bridge import GOODBYE_S, POLL_S, STALE_S, Bridge, BridgeError, Item
from touchd.daemon.bridges.settings import LslSettings, Ros2Settings
from touchd.daemon.path.events import Event
from touchd.drivers.frame import Frame

MOST_MB = 16
# liblsl starts a thread for each listener; a few stacks of the usual 8 MB would exceed MOST_MB.
SMALL_STACKS = ("/bin/sh", "-c", 'ulimit -s 512; exec "$@"', "sh")
PROGRAM = (sys.executable, "-m", "touchd.daemon.bridges.process")
# Reserve less memory that is never used; import no module from the working folder.
ENVIRONMENT = {"MALLOC_ARENA_MAX": "2", "OPENBLAS_NUM_THREADS": "1", "PYTHONSAFEPATH": "1"}
READY = "ready"
MOST_LINE_BYTES = 1000


class Outlet(Protocol):
    """Publishes one pad's events and frames. Raises BridgeError if the process must be restarted."""

    def send_event(self, event: Event) -> None: ...
    def send_frame(self, frame: Frame) -> None: ...


class ProcessBridge(Bridge):
    """Sends the events and frames of all pads to a process, and restarts that process when it ends.

    name: of the robot.
    """

    # A start takes half a second of a core.
    retry_s = 5.0

    def __init__(self, section: LslSettings | Ros2Settings, name: str, pads: Sequence[str]) -> None:
        library, domain = ("ros2", section.domain) if isinstance(section, Ros2Settings) else ("lsl", 0)
        self._arguments = (library, str(domain), name, *pads)
        self._process: subprocess.Popen[bytes] | None = None
        super().__init__(library, pads, math.inf, "its own process")

    def hold(self) -> str:
        with subprocess.Popen(
            [*SMALL_STACKS, *PROGRAM, *self._arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env=os.environ | ENVIRONMENT,
        ) as process:
            assert process.stdin is not None
            os.set_blocking(process.stdin.fileno(), False)
            self._process = process
            try:
                last = self._listen(process)
                process.wait(GOODBYE_S)
            finally:
                process.kill()
        if process.returncode < 0:
            return f"it was ended: it hung, or others on the network sent more than {MOST_MB} MB"
        return last or f"it ended with code {process.returncode}"

    def stop(self, timeout_s: float) -> None:
        super().stop(timeout_s)
        # A process that hangs would outlive the daemon.
        if self._process is not None:
            self._process.kill()

    def send_event(self, event: Event) -> bool:
        return self._write(event)

    def send_frame(self, frame: Frame, pad: str) -> None:
        self._write((frame, pad))

    def hang_up(self) -> None:
        if self._process is not None and self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()

    def _write(self, item: Item) -> bool:
        """Write an item; return False if the process has ended or hangs, or if the daemon is stopping."""
        process, data, until_s = self._process, pickle.dumps(item), time.monotonic() + STALE_S
        if process is None or process.stdin is None:
            return False
        try:
            while data and not self._abandoned.is_set():
                if select.select([], [process.stdin], [], POLL_S)[1]:
                    data = data[os.write(process.stdin.fileno(), data) :]
                elif time.monotonic() >= until_s:
                    process.kill()
        # ValueError: the pipe is closed.
        except (OSError, ValueError):
            return False
        return not data

    def _listen(self, process: subprocess.Popen[bytes]) -> str:
        """Log what the process logs, until it ends; returns the last line."""
        assert process.stderr is not None
        last = ""
        for line in iter(partial(process.stderr.readline, MOST_LINE_BYTES), b""):
            last = line.decode(errors="replace").rstrip("\n")
            if last == READY:
                self.connected()
            else:
                self._log.info("%s: %s", self.name, last)
        return last


def main(arguments: Sequence[str]) -> None:
    """Publish the pickled items that arrive on standard input, for some pads."""
    # Ignore signals to the process group: this process ends when the daemon closes its standard input.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    try:
        _publish(_outlets(*arguments))
    # pylsl raises RuntimeError without liblsl, as on a processor that liblsl is not built for.
    except (ImportError, RuntimeError) as error:
        sys.exit(f"cannot be used on this machine ({' '.join(str(error).split())})")
    except BridgeError as error:
        sys.exit(str(error))
    except MemoryError:
        # Python may lack the memory for an orderly exit.
        signal.raise_signal(signal.SIGKILL)


def _outlets(library: str, domain: str, name: str, *pads: str) -> dict[str, Outlet]:
    """Return an outlet for each pad. domain: of ROS 2. name: of the robot."""
    if library == "lsl":
        from touchd.daemon.bridges.lsl import LslOutlet

        return {pad: LslOutlet(name, pad) for pad in pads}
    from touchd.daemon.bridges.ros2 import Ros2Outlet

    return {pad: Ros2Outlet(int(domain), name, pad) for pad in pads}


def _publish(outlets: Mapping[str, Outlet]) -> None:
    """Publish items until standard input ends."""
    _limit_memory()
    sys.stderr.write(f"{READY}\n")
    sys.stderr.flush()
    # A partial item: the daemon has stopped, or was killed.
    with suppress(EOFError, pickle.UnpicklingError):
        while True:
            item: Item = pickle.load(sys.stdin.buffer)
            if not isinstance(item, tuple):
                for pad in [item.pad] if hasattr(item, "pad") else outlets:
                    outlets[pad].send_event(item)
            # A slow reader delays frames, and must not delay the events behind them.
            elif time.monotonic() - item[0].host_s < STALE_S:
                frame, pad = item
                outlets[pad].send_frame(frame)


def _limit_memory() -> None:
    """Limit this process to MOST_MB more memory than it has now."""
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    limit = int(fields["VmData"].split()[0]) * 1024 + MOST_MB * 1_000_000
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


if __name__ == "__main__":
    main(sys.argv[1:])
