"""The spawned daemon on a fake pad, with a configuration that a test can change while it runs."""

import signal
from pathlib import Path
from typing import Any

import msgspec
import yaml
from rigs.expectations import LENGTHS
from rigs.patient_port import PATIENT, PatientPort, playing
from rigs.wait import WITHIN_S, wait_for

from daemon.config import SensorSettings, Settings
from daemon.events import Event
from daemon.playback.rig import SpawnedDaemon
from drivers.fakes.fake_port import FakePort

SPEED = 16.0


class Daemon:
    """The spawned daemon on a fake pad, its log, and its configuration."""

    def __init__(self, folder: Path) -> None:
        self.port = playing(LENGTHS, SPEED)
        self.settings = Settings(sensor=SensorSettings(port=self.port.path), scene=PATIENT)
        self._folder = folder
        self._log = (folder / "log").open("w+b")
        self._daemon = SpawnedDaemon(self.settings, folder, self._log)
        self.port.reader = self._daemon.process.pid
        self.port.start()
        self._events = self._daemon.events()
        self.events: list[Event] = []

    def configure(self, **changes: Any) -> None:
        """Write other settings and make the daemon reread them."""
        self.write(yaml.safe_dump(msgspec.to_builtins(msgspec.structs.replace(self.settings, **changes))))

    def write(self, text: str) -> None:
        (self._folder / "touchd.yaml").write_text(text)
        self._daemon.process.send_signal(signal.SIGHUP)

    def await_event(self, kind: type) -> None:
        for event in self._events:
            self.events.append(event)
            if isinstance(event, kind):
                return
        raise AssertionError(f"the daemon ended without {kind}: {self.log()}")

    def log(self) -> list[str]:
        """Its log lines about its configuration so far."""
        lines = (self._folder / "log").read_text().splitlines()
        return [line for line in lines if "daemon.setup.reread" in line]

    def await_log(self, count: int) -> None:
        wait_for(lambda: len(self.log()) >= count)

    def finish(self) -> list[Event]:
        """Play to the end, and return all events."""
        assert self.port.wait(WITHIN_S)
        self.port.settle()
        self._daemon.process.terminate()
        self.events += self._events
        assert self._daemon.stop() == 0
        return self.events

    def close(self) -> None:
        self._daemon.stop()
        self.port.stop()
        self._log.close()


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
