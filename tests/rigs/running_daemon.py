"""The spawned daemon on a fake pad, its events and its log."""

import re
import threading
from pathlib import Path
from typing import IO, Any

from rigs.expectations import LENGTHS
from rigs.patient_port import PATIENT, PatientPort, playing
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.path.events import Event
from touchd.daemon.playback.rig import SpawnedDaemon
from touchd.drivers.fakes.fake_port import FakePort

SPEED = 16.0
SERVED = re.compile(r"live page: (http://\S+)/")
TOTALS = re.compile(r"(\d+) frames, (\d+) touches, (\d+) frames dropped in all")


class Daemon:
    """The spawned daemon on a pad: its events, and its log.

    pad: a started port; by default its own, which plays LENGTHS. log: by default a file.
    """

    def __init__(
        self, folder: Path, pad: FakePort | None = None, log: IO[bytes] | None = None, **settings: Any
    ) -> None:
        self.port = pad or playing(LENGTHS, SPEED)
        self._own_port = None if pad else self.port
        defaults = {"sensor": SensorSettings(port=self.port.path), "scene": PATIENT}
        self.settings = Settings(**(defaults | settings))
        self._folder = folder
        self._log = log or (folder / "log").open("wb")
        self._daemon = SpawnedDaemon(self.settings, folder, self._log)
        self.process = self._daemon.process
        if isinstance(self.port, PatientPort):
            self.port.reader = self.process.pid
        self.events: list[Event] = []
        self._awaited = 0
        self._reader = threading.Thread(target=lambda: self.events.extend(self._daemon.events()))
        self._reader.start()
        if self._own_port:
            self._own_port.start()

    @property
    def log(self) -> str:
        return (self._folder / "log").read_text()

    @property
    def url(self) -> str:
        """The address of its live page, once it is served."""

        def served() -> re.Match[str] | None:
            assert self.process.poll() is None, self.log
            return SERVED.search(self.log)

        return wait_for(served)[1]  # type: ignore[index]

    def await_event(self, kind: type) -> None:
        """Wait for the next event of a kind."""

        def came() -> bool:
            assert self._reader.is_alive() or self._awaited < len(self.events), self.log
            new = self.events[self._awaited :]
            found = next((number for number, event in enumerate(new, 1) if isinstance(event, kind)), 0)
            self._awaited += found or len(new)
            return found > 0

        wait_for(came)

    def finish(self) -> list[Event]:
        """Play to the end, and return all events."""
        assert self.port.wait(WITHIN_S)
        if isinstance(self.port, PatientPort):
            self.port.settle()
        assert self.stop() == 0
        return self.events

    def stop(self) -> int:
        """Stop it, kill it where it hangs, and return its exit code; may be repeated."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            return self.process.wait(WITHIN_S)
        finally:
            self.process.kill()
            self._reader.join()
            self._daemon.stop()

    def __enter__(self) -> "Daemon":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._log.close()
        if self._own_port:
            self._own_port.stop()


def totals(log: str) -> tuple[int, int, int]:
    """Return the frames, touches and dropped frames that a daemon reported at its end."""
    found = TOTALS.search(log)
    assert found is not None, log
    return int(found[1]), int(found[2]), int(found[3])


def run_daemon(
    settings: Settings, folder: Path, *until: FakePort, within_s: float = WITHIN_S
) -> tuple[list[Event], str]:
    """Run the daemon until these ports have been played; return its events and its log."""
    with (folder / "log").open("w+b") as log:
        daemon = SpawnedDaemon(settings, folder, log)
        patient = [port for port in until if isinstance(port, PatientPort)]
        try:
            for port in patient:
                port.reader = daemon.process.pid
            assert all(port.wait(within_s) for port in until), "the daemon did not take what was played"
            for port in patient:
                port.settle()
        finally:
            daemon.process.terminate()
            events = list(daemon.events())
            exit_code = daemon.stop()
        log.seek(0)
        said = log.read().decode()
    assert exit_code == 0, said
    return events, said
