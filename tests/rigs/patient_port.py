"""A fake pad that waits for the daemon, so that a busy machine loses no frame."""

import math
import time
from contextlib import suppress
from pathlib import Path

from rigs.expectations import stream_of

from touchd.daemon.app.config import SceneSettings, SensorSettings
from touchd.daemon.playback.rig import encoder_for
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.recording import Stream

# A tenth of the daemon's queue.
FRAMES_AT_ONCE = 54
LOOK_S = 0.002
# A pad that is silent for two seconds counts as away.
LONGEST_S = 0.5


# Tell every answer, however late on a busy machine.
PATIENT = SceneSettings(stale_s=60.0)


class PatientPort(FakePort):
    """A fake port that lets the daemon process a second's frames before it sends more.

    reader: the daemon's process; until it is set, the port only keeps its pace.
    """

    reader: int | None = None

    def settle(self, within_s: float = math.inf) -> None:
        """Wait until the daemon is idle."""
        until_s = time.monotonic() + within_s
        while self.reader is not None and not all_wait(self.reader):
            if self._stop.wait(LOOK_S) or time.monotonic() > until_s:
                return

    def _send(self, index: int, packet: bytes) -> None:
        if index % FRAMES_AT_ONCE == 0:
            self.settle(LONGEST_S)
        super()._send(index, packet)


def playing(what: Path | Stream, speed: float, *, loop: bool = False) -> PatientPort:
    """A patient port that plays a stream, or a shipped recording, in the default format."""
    stream = stream_of(what) if isinstance(what, Path) else what
    return PatientPort(stream, encoder_for(SensorSettings()), speed=speed, loop=loop)


def all_wait(pid: int) -> bool:
    """Whether all threads of a process sleep; see proc(5). True of one that has ended."""
    with suppress(FileNotFoundError, ProcessLookupError):
        for thread in Path(f"/proc/{pid}/task").iterdir():
            if thread.joinpath("stat").read_text().rpartition(")")[2].split()[0] in "RD":
                return False
    return True
