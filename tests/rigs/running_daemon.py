"""The spawned daemon on a fake pad, with a configuration that a test changes while it runs."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

import msgspec
import yaml
from rigs.expectations import LENGTHS, stream_of

from daemon.config import SensorSettings, Settings
from daemon.events import Event
from daemon.playback.rig import SpawnedDaemon
from daemon.setup.destinations import encoder_for
from drivers.fakes.fake_port import FakePort

SPEED = 16.0


class Daemon:
    """The spawned daemon on a fake pad, the lines of its log, and its configuration to write anew."""

    def __init__(self, folder: Path) -> None:
        self.port = FakePort(stream_of(LENGTHS), encoder_for(SensorSettings()), speed=SPEED)
        self.settings = Settings(sensor=SensorSettings(port=self.port.path))
        self._folder = folder
        self._log = (folder / "log").open("w+b")
        self._daemon = SpawnedDaemon(self.settings, folder, self._log)
        self.port.start()
        self._events = self._daemon.events()
        self.events: list[Event] = []

    def configure(self, **changes: Any) -> None:
        """Write other settings and have them read."""
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
        """What it said of its configuration so far."""
        lines = (self._folder / "log").read_text().splitlines()
        return [line for line in lines if "daemon.setup.reread" in line]

    def await_log(self, count: int) -> None:
        while len(self.log()) < count:
            time.sleep(0.01)

    def finish(self) -> list[Event]:
        """Play to the end, and return all events."""
        assert self.port.wait(25)
        self._daemon.process.terminate()
        self.events += self._events
        assert self._daemon.stop() == 0
        return self.events

    def close(self) -> None:
        self._daemon.stop()
        self.port.stop()
        self._log.close()


def run_daemon(
    settings: Settings, folder: Path, *until: FakePort, within_s: float = 25
) -> tuple[list[Event], str]:
    """Run the daemon until these ports have been played; return its events and its log."""
    with (folder / "log").open("w+b") as log:
        daemon = SpawnedDaemon(settings, folder, log)
        try:
            assert all(port.wait(within_s) for port in until), "the daemon did not take what was played"
        finally:
            daemon.process.terminate()
            events = list(daemon.events())
            exit_code = daemon.stop()
        log.seek(0)
        said = log.read().decode()
    assert exit_code == 0, said
    return events, said
